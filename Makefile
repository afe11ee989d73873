# make demo | make test | make install: each sets up what it needs; nothing is installed outside .venv
PYTHON ?= $(shell for p in python3.12 python3.11 python3 python; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin

.PHONY: install dev demo test lint bench clean

install: $(VENV)/installed
dev: $(VENV)/installed-dev

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "capture needs Python 3.11 or 3.12, and none was found. Install one, or name it: make PYTHON=/path/to/python3.12"; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable . --constraint constraints.txt
	@touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]' --constraint constraints.txt
	@touch $@

# the two commands of the README, on the log shipped in datasets/
demo: install
	$(BIN)/capture identify --real-log datasets/cart/cart.zarr --task datasets/cart/task.toml --out runs/demo --force

test: dev
	$(BIN)/python -m pytest -q -n 2

lint: dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

bench: dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[benchmarks]' --constraint constraints.txt
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) build *.egg-info
