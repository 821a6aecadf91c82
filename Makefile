# Two commands do all the set-up: `make run` and `make test`. Both need only Python 3.11+ and make.
# `make test` runs part after part and stops after the first that fails; the quickest come first. What takes long and rarely
# breaks is marked `slow`, or needs Dask or ROS, and is run by `make test-slow`.
PYTHON ?= python3
VENV   := .venv
ifeq ($(OS),Windows_NT)
BIN    := $(VENV)/Scripts
else
BIN    := $(VENV)/bin
endif
SAMPLE := maps/sample
SITE   := build/docs
LINT   := style types scripts structure
# Parts of the suite: what needs no server and no process, what is not named here, pages without and with a browser.
QUICK  := tests/core tests/files tests/store
PAGES  := tests/web tests/missions
# Run on PostgreSQL, too, the first few by `make test`, all by `make test-slow`: stores, jobs and workers with their kills, missions and their intake, edits by the API,
# faults of the network and of the server.
SERVER  := tests/store/test_postgresql.py tests/store/maps
RECORDS := tests/store tests/jobs/test_worker.py tests/jobs/test_intake_kills.py tests/missions/tasks/test_query_mission.py \
           tests/missions/tasks/test_mission_import.py tests/missions/tasks/test_thin_tracks.py tests/missions/tasks/test_preview.py \
           tests/web/maps/test_api_maps.py tests/web/maps/test_edit_answers.py tests/web/test_numbers.py tests/tasks/find \
           tests/jobs/test_network_cut.py tests/web/operate/test_database_faults.py
REST    = $(filter-out $(QUICK) $(PAGES) tests/browser tests/cluster tests/vendor tests/__pycache__ tests/%.py, $(wildcard tests/*)) \
          $(wildcard tests/test_*.py)
# In a process of their own, with the tests of ROS beside them, which wait most of the time.
# Clients of Dask that lose their scheduler leave coroutines behind, which pytest would count against any later test.
CLUSTER := -p no:unraisableexception -W "ignore:coroutine:RuntimeWarning" tests/cluster
# Tests that start servers and commands or use a browser wait for a part of their time: more of them at once than processors.
PROCESSES = $(shell expr $$(nproc 2>/dev/null || echo 2) \* 3 / 2)
# The tests of a file share what they need, so they run in one process; `tests/conftest.py` orders the files.
PYTEST  = $(BIN)/pytest -n auto --dist loadfile --no-loadscope-reorder
# Of tests of several processes and of browsers, those that fail (status 1) run once more, alone: a loaded machine can upset their timing.
define twice
	$(PYTEST) -n $(PROCESSES) -q $(1) || { [ $$? -eq 1 ] || exit 1; echo "what failed runs once more, alone"; $(BIN)/pytest -q --last-failed --last-failed-no-failures none $(1); }
endef
PIP    := $(BIN)/python -m pip install --disable-pip-version-check
# By environment, so that what builds the package is pinned too.
export PIP_CONSTRAINT       := constraints.txt
export PIP_BUILD_CONSTRAINT := constraints.txt
# Many tests start a server or a command: without compiled modules each takes a second of computing more.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install run lint style types scripts structure quick postgresql test test-slow test-changed browser cluster ros-install ros-test fuzz coverage audit docs translations robot clean

help:            ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/ -/'

install: $(VENV)/.installed ## make .venv with the command expmap in it

define make-venv
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed, this is " + sys.version.split()[0] + ": make PYTHON=python3.12 ...")'
	@echo "installing Experience Map into $(VENV): about a minute, longer where the network is slow; pip says what it fetches"
	$(PYTHON) -m venv $(VENV)
endef

$(VENV)/.installed: pyproject.toml constraints.txt
	$(make-venv)
	$(PIP) -e '.[all]'
	@touch $@

# Python compiles what the tests use; pip would compile a thousand modules more.
$(VENV)/.tested: pyproject.toml constraints.txt
	$(make-venv)
	$(PIP) --no-compile -e '.[all,test]'
	@touch $(VENV)/.installed $@

run: install     ## make the sample map, localize a photo on it, start the web application and print its address
	@echo "1 of 3: the sample, a park of 60 drawn photos in $(SAMPLE): half a minute, on a slow machine three"
	$(BIN)/expmap sample $(SAMPLE)
	@echo "2 of 3: where was a new photo of the park taken?"
	$(BIN)/expmap localize $(SAMPLE)/map.cfg $(SAMPLE)/queries/query_02.jpg
	@echo "3 of 3: the web application: open the link that says sign in, and stop it with Ctrl-C"
	$(BIN)/expmap serve --library maps

lint: $(VENV)/.tested ## check style and types, also of the scripts of the pages; print what the program is made of
	@$(MAKE) --no-print-directory -j 2 $(LINT)

style: $(VENV)/.tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.tested
	$(BIN)/mypy

scripts: $(VENV)/.tested
	$(BIN)/python tests/js/check.py

structure:       ## print how many files, lines and modules with one importer the program has
	@$(PYTHON) benchmarks/structure.py

quick: $(VENV)/.tested ## run the tests that need no server, no browser and no other process, in less than a minute
	$(PYTEST) -q $(QUICK)

postgresql: $(VENV)/.tested ## run the database tests on PostgreSQL, which they start themselves
	$(PYTEST) -q --database postgresql $(RECORDS)

# What is installed comes side by side, as a part of it is computing and another waiting for the network.
test:            ## run what must pass before each commit; installs chromium with apt if there is no browser
	@$(MAKE) --no-print-directory -j 2 $(VENV)/.tested browser
	@$(MAKE) --no-print-directory -j 2 $(LINT)
	$(PYTEST) -q -m "not slow" $(QUICK)
	$(PYTEST) -q -m "not slow" $(wildcard $(PAGES))
	$(PYTEST) -n $(PROCESSES) -q -m "not slow" --database postgresql $(SERVER)
	$(call twice,-m "not slow" $(REST))
	$(call twice,-m "not slow" tests/browser)

test-slow:       ## run the rest: long builds and kills, installs, each page in four looks, all records on PostgreSQL, Dask, ROS
	@$(MAKE) --no-print-directory -j 3 $(VENV)/.tested browser ros-install
	$(call twice,--database postgresql $(RECORDS))
	$(call twice,-m slow $(filter-out tests/cluster, $(wildcard tests/*/)))
	@$(MAKE) --no-print-directory -j 2 cluster ros-test

test-changed: $(VENV)/.tested ## run the quick tests of what differs from main: of changed modules, and of modules that import them
	@$(BIN)/python tests/changed.py --run

browser:
	$(PYTHON) tests/browser/ensure_browser.py

ros-install:
	$(PYTHON) ros/install.py $(VENV)

cluster: $(VENV)/.tested ## run the tests of computing on several machines
	$(BIN)/pytest -q $(CLUSTER)

ros-test: $(VENV)/.tested ros-install ## run the tests of the ROS 2 nodes, with ROS 2 wheels in .venv-ros
	$(BIN)/python ros/run_tests.py

fuzz: $(VENV)/.tested ## search for inputs that break a property, with new random ones each time
	$(PYTEST) -m hypothesis --hypothesis-profile fuzz

coverage: $(VENV)/.tested ## run the tests that need no browser and print their line coverage; takes half as long again
	$(PYTEST) -q --ignore tests/browser --ignore tests/cluster --cov=webapp --cov-report=term:skip-covered

audit: $(VENV)/.tested ## check dependencies for known vulnerabilities, changed vendored scripts and unusual licences
	@$(BIN)/python tests/design/audit.py

docs: $(VENV)/.tested ## build docs/ as a site in build/docs; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --config-file .mkdocs.yml --site-dir $(SITE)
	@echo "open $(SITE)/index.html"

translations: $(VENV)/.tested ## collect the texts of pages and scripts for translators, and compile their translations
	$(BIN)/python docs/make_translations.py

robot: $(VENV)/.tested ## build the robot client as a separate wheel, dist/experience_map_robot-*.whl
	$(BIN)/python -m build --wheel --no-isolation --outdir dist webapp/robot

clean:           ## remove everything that was built here, except maps
	rm -rf $(VENV) .venv-ros build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
