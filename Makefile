# `make demo` shows the whole system at work, `make test` checks it. Both set themselves up.

PYTHON ?= python3.11
VENV := .venv
READY := $(VENV)/ready

.PHONY: demo test test-all clean

demo: $(READY)
	$(VENV)/bin/python -m experiments.demo --output=demo

test: $(READY)
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/python -m pytest -q -n 2

test-all: $(READY)
	$(VENV)/bin/python -m pytest -q -m ''

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt --editable '.[test]'
	touch $@

clean:
	rm -rf $(VENV) demo
