# make demo | make smoke | make test | make pipeline | make install: each sets up what it needs; nothing is installed
# outside .venv (and .venv-core and .venv-site, which make test-core and make site have for themselves). make demo and
# make install need the core alone; make test and what else works on the project need every extra, too. An environment
# that has them all keeps them.
SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(shell for p in python3.12 python3.11 python3.13 python3 python; do \
	$$p -c '$(SUPPORTED)' >/dev/null 2>&1 && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
CORE := .venv-core
SITE := .venv-site
SMOKE = $(shell grep -l "mark\.smoke" tests/test_*.py)
VERSIONS := pyproject.toml $(wildcard constraints/*.txt)
ALL := constraints/all.txt --editable '.[all,dev]'
# modules are compiled when they are imported: all of them at once would be half of the time, and 130 MB
PIP := -m pip install --quiet --disable-pip-version-check --no-compile --constraint

.PHONY: install dev demo test smoke test-core test-wheel pipeline lint bench docs site clean

install: $(VENV)/installed
dev: $(VENV)/installed-all

%/bin/python:
	@test -n "$(PYTHON)" || { echo "capture needs Python 3.11 to 3.13, and none was found."; \
		echo "  cure: install one, or name it: make $(MAKECMDGOALS) PYTHON=/path/to/python3.12"; exit 2; }
	@$(PYTHON) -c '$(SUPPORTED)' 2>/dev/null || { echo "capture needs Python 3.11 to 3.13, and $(PYTHON) is" \
		"$$($(PYTHON) -c 'import platform; print(platform.python_version())' 2>/dev/null || echo not one) (MuJoCo 4 and zarr 3 need 3.11)."; \
		echo "  cure: name another: make $(MAKECMDGOALS) PYTHON=/path/to/python3.12"; exit 2; }
	$(PYTHON) -m venv $* || { rm -rf $*; exit 2; }

.PRECIOUS: %/bin/python

$(VENV)/installed: $(VERSIONS) | $(BIN)/python
	$(BIN)/python $(PIP) $(if $(shell ls $(VENV)/installed-all 2>/dev/null),$(ALL),constraints/core.txt --editable .)
	@touch $@

$(VENV)/installed-all: $(VERSIONS) | $(BIN)/python
	$(BIN)/python $(PIP) $(ALL)
	@touch $@

$(VENV)/installed-benchmarks: $(VENV)/installed-all
	$(BIN)/python $(PIP) constraints/all.txt --editable '.[benchmarks]'
	@touch $@

$(CORE)/installed: $(VERSIONS) | $(CORE)/bin/python
	$(CORE)/bin/python $(PIP) constraints/core.txt --editable '.[dev]'
	@touch $@

$(SITE)/installed: constraints/packages.txt | $(SITE)/bin/python
	$(SITE)/bin/python $(PIP) constraints/packages.txt mkdocs-material
	@touch $@

# the two commands of the README, on the log shipped in datasets/
demo: install
	$(BIN)/capture identify --real-log datasets/air_hockey.zarr --out runs/demo/estimate --force
	$(BIN)/capture diagnose --real-log datasets/air_hockey.zarr --estimate runs/demo/estimate --out runs/demo/diagnosis --force

# no test may be left out here for want of an extra; modules go by name, for the last of those are short: by their number
# of tests, as xdist would have it, the longest scripts come last
test: dev
	CAPTURE_ALL_EXTRAS=1 $(BIN)/python -m pytest -q -n 2 --dist loadscope --no-loadscope-reorder

# a minute, to be run first: every command once on tiny inputs, and what all plug-ins promise
smoke: dev
	CAPTURE_ALL_EXTRAS=1 $(BIN)/python -m pytest -q -n 2 -m smoke $(SMOKE)

# without the extras, with numpy 2: all that the core can do, or TESTS="tests/test_cli.py ..." alone
test-core: $(CORE)/installed
	$(CORE)/bin/python -m pytest -q -n 2 $(TESTS)

# a wheel of what is committed, in an environment outside of this folder that has nothing else
test-wheel: $(CORE)/installed
	tests/installed_wheel.sh $(CORE)/bin/python

# every stage by shell, on sizes that take a minute: `make test` runs the same script
pipeline: dev
	rm -rf runs/pipeline
	CAPTURE="$(CURDIR)/$(BIN)/capture" docs/closed_loop.sh runs/pipeline tiny

lint: dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

bench: $(VENV)/installed-benchmarks
	$(BIN)/python -m benchmarks

# the pages of docs/ that are made from the code
docs: dev
	$(BIN)/python -m docs.generate

# all pages, to be opened at site/index.html, with a search where they are served (python -m http.server -d site); a dead
# link ends it
site: $(SITE)/installed
	$(SITE)/bin/mkdocs build --strict

clean:
	rm -rf $(VENV) $(CORE) $(SITE) build site *.egg-info
