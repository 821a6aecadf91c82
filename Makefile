# Two commands do all the set-up: `make run` and `make test`. Both need only Python 3.11+ and make.
PYTHON ?= python3
VENV   := .venv
ifeq ($(OS),Windows_NT)
BIN    := $(VENV)/Scripts
else
BIN    := $(VENV)/bin
endif
SAMPLE := maps/sample
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# By environment, so that what builds the package is pinned too.
export PIP_CONSTRAINT       := constraints.txt
export PIP_BUILD_CONSTRAINT := constraints.txt

.PHONY: help install run lint test translations robot clean

help:            ## say what can be made
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/ -/'

install: $(VENV)/.installed ## make .venv with the command expmap in it

$(VENV)/.installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed, this is " + sys.version.split()[0] + ": make PYTHON=python3.12 ...")'
	@echo "installing Experience Map into $(VENV), which takes about a minute"
	$(PYTHON) -m venv $(VENV)
	$(PIP) -e '.[all]'
	@touch $@

$(VENV)/.tested: $(VENV)/.installed
	@echo "installing what the tests need"
	$(PIP) -e '.[all,test]'
	@touch $@

run: install     ## make the sample map, localize a photo on it, start the web application and print its address
	$(BIN)/expmap sample $(SAMPLE)
	$(BIN)/expmap localize $(SAMPLE)/map.cfg $(SAMPLE)/queries/query_02.jpg
	@echo "starting the web application: open the link that says sign in, and stop it with Ctrl-C"
	$(BIN)/expmap serve --library maps

lint: $(VENV)/.tested ## check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python tests/js/check.py

test: lint       ## run everything that must pass; installs chromium through apt where there is no browser
	$(BIN)/python tests/browser/ensure_browser.py
	$(BIN)/pytest -n auto --dist loadgroup

translations: $(VENV)/.tested ## collect the texts of pages and scripts for translators, and compile what they wrote
	$(BIN)/python docs/make_translations.py

robot: $(VENV)/.tested ## build the client of robots as a wheel of its own, dist/experience_map_robot-*.whl
	$(BIN)/python -m build --wheel --no-isolation --outdir dist webapp/robot

clean:           ## remove what was made here, but no map
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
