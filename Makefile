# `make demo` shows the whole system, `make test` checks it. Both create what they need in .venv.
# `make wheel` builds dist/cvn-*.whl, with compiled kernels if there is a C++ compiler.
# `make docs` builds the documentation: build/docs/index.html.

# The newest supported Python that can create virtual environments.
PYTHON ?= $(shell for p in python3.14 python3.13 python3.12 python3.11 python3; do \
  $$p -c 'import ensurepip, sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null && \
  echo $$p && break; done)
VENV := .venv
READY := $(VENV)/ready

.PHONY: demo docs test test-all wheel clean

demo: $(READY)
	$(VENV)/bin/python -m experiments.demo --output=demo

docs: $(READY)
	$(VENV)/bin/sphinx-build --quiet --fail-on-warning --jobs 2 docs build/docs

test: $(READY) docs
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/python -m pytest -q -n 2

test-all: $(READY)
	$(VENV)/bin/python -m pytest -q -m ''

wheel: $(READY)
	$(VENV)/bin/python -m pip wheel --verbose --no-deps --wheel-dir dist .

$(READY): pyproject.toml constraints.txt
	@$(if $(PYTHON),,echo 'make: found no Python 3.11 to 3.14 with venv: install one (on Debian \
	  python3 and python3-venv), or give its path: make PYTHON=...' >&2; exit 1)
	$(VENV)/bin/python -c '' 2>/dev/null || $(PYTHON) -m venv --clear $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt --editable '.[test]'
	touch $@

clean:
	rm -rf $(VENV) build demo dist docs/api
