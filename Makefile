# `make demo` shows the whole system at work, `make test` checks it. Both set themselves up.
# `make wheel` makes dist/cvn-*.whl, with compiled kernels if there is a C++ compiler.

# The newest Python that the project supports and that can make virtual environments.
PYTHON ?= $(shell for p in python3.14 python3.13 python3.12 python3.11 python3; do \
  $$p -c 'import ensurepip, sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null && \
  echo $$p && break; done)
VENV := .venv
READY := $(VENV)/ready

.PHONY: demo test test-all wheel clean

demo: $(READY)
	$(VENV)/bin/python -m experiments.demo --output=demo

test: $(READY)
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/python -m pytest -q -n 2

test-all: $(READY)
	$(VENV)/bin/python -m pytest -q -m ''

wheel: $(READY)
	$(VENV)/bin/python -m pip wheel --verbose --no-deps --wheel-dir dist .

$(READY): pyproject.toml constraints.txt
	@$(if $(PYTHON),,echo 'make: no Python 3.11 to 3.14 with venv was found: install one (on Debian \
	  python3 and python3-venv), or name it: make PYTHON=...' >&2; exit 1)
	$(VENV)/bin/python -c '' 2>/dev/null || $(PYTHON) -m venv --clear $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt --editable '.[test]'
	touch $@

clean:
	rm -rf $(VENV) demo dist
