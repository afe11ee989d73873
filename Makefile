# make demo | make test | make pipeline | make install: each sets up what it needs; nothing is installed outside .venv
SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))
PYTHON ?= $(shell for p in python3.12 python3.11 python3 python; do \
	$$p -c '$(SUPPORTED)' >/dev/null 2>&1 && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: install dev demo test pipeline lint bench docs clean

install: $(VENV)/installed
dev: $(VENV)/installed-dev

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "capture needs Python 3.11 or 3.12, and none was found."; \
		echo "  cure: install one, or name it: make $(MAKECMDGOALS) PYTHON=/path/to/python3.12"; exit 2; }
	@$(PYTHON) -c '$(SUPPORTED)' 2>/dev/null || { echo "capture needs Python 3.11 or 3.12, and $(PYTHON) is" \
		"$$($(PYTHON) -c 'import platform; print(platform.python_version())' 2>/dev/null || echo not one) (MuJoCo 4 and zarr 3 need 3.11)."; \
		echo "  cure: name another: make $(MAKECMDGOALS) PYTHON=/path/to/python3.12"; exit 2; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 2; }

$(VENV)/installed: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable .
	@touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(PIP) --editable '.[dev]'
	@touch $@

$(VENV)/installed-benchmarks: $(VENV)/installed-dev
	$(PIP) --editable '.[benchmarks]'
	@touch $@

# the two commands of the README, on the log shipped in datasets/
demo: install
	$(BIN)/capture identify --real-log datasets/air_hockey.zarr --out runs/demo/estimate --force
	$(BIN)/capture diagnose --real-log datasets/air_hockey.zarr --estimate runs/demo/estimate --out runs/demo/diagnosis --force

test: dev
	$(BIN)/python -m pytest -q -n 2

# every stage once, by shell, on sizes that take minutes
pipeline: install
	rm -rf runs/pipeline
	CAPTURE="$(CURDIR)/$(BIN)/capture" docs/pipeline.sh runs/pipeline

lint: dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

bench: $(VENV)/installed-benchmarks
	$(BIN)/python -m benchmarks

# the pages of docs/ that are made from the code
docs: dev
	$(BIN)/python -m docs.generate

clean:
	rm -rf $(VENV) build *.egg-info
