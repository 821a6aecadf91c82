# Two commands do all the set-up: `make run` and `make test`. Both need only Python 3.11+ and make.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin

.PHONY: install run test lint clean help

help:            ## what can be made
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/ -/'

install: $(VENV)/.installed ## .venv with the command expmap in it

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed, this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/.tested: pyproject.toml constraints.txt $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	@touch $@

run: install     ## make the sample map and localize a photo on it
	$(BIN)/expmap sample
	$(BIN)/expmap localize maps/sample/map.cfg maps/sample/queries/query_00.jpg --picture maps/sample/where.png --matches maps/sample/matches.png

lint: $(VENV)/.tested ## linters and types
	$(BIN)/ruff check .
	$(BIN)/mypy

test: $(VENV)/.tested lint ## everything
	$(BIN)/pytest -n auto --dist loadgroup

clean:           ## remove what was made here, but no map
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache
