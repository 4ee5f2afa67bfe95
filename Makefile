# make demo   a Monte Carlo run of every demo scenario: a table, and reports/demo.html
# make test   the everyday tests        make lint    format, lint, types
# make gate   the tracker beside that of commit AGAINST, trial by trial
# make verify the long statistical suite        make bench   speed
SHELL := /bin/bash
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
BASE := $(VENV)/.base
NATIVE := CMakeLists.txt $(wildcard pmbm/native/*)
AGAINST ?= HEAD~1
CHECK_NATIVE := $(BIN)/python -c 'from pmbm.kernels import native; native or print("Nothing was compiled: the plain filter works, and takes ten times as long. pip install -v -e . says why.")'
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1

# Seeds of the demonstration are kept for reporting: nothing was tuned on them.
DEMO := single_straight crossing truck_occlusion roundabout
DEMO_SEED := 20210606

.PHONY: demo test lint gate verify bench clean
.DEFAULT_GOAL := test

$(BIN)/python:
	@python=""; \
	for candidate in python3 python3.13 python3.12 python3.11 python; do \
	  if $$candidate -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then \
	    python=$$candidate; break; \
	  fi; \
	done; \
	if [ -z "$$python" ]; then \
	  echo "No Python 3.11 or newer with venv and ensurepip was found on PATH: install one (Debian: apt install python3 python3-venv) and run make again." >&2; \
	  exit 1; \
	fi; \
	$$python -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --upgrade pip

# What the demo needs and no more: about half of what the tests need.
$(BASE): pyproject.toml Makefile $(NATIVE) | $(BIN)/python
	@echo "Setting up $(VENV), once: packages from PyPI, and the kernels compiled where a C++ compiler is. It takes a minute or a few."
	$(BIN)/python -m pip install --quiet --editable .
	@$(CHECK_NATIVE)
	@touch $@

$(STAMP): pyproject.toml Makefile $(NATIVE) | $(BIN)/python
	@echo "Setting up $(VENV), once: packages from PyPI for tests, linters and datasets, and the kernels compiled where a C++ compiler is. It takes a few minutes."
	$(BIN)/python -m pip install --quiet --editable '.[test,lint,tune,waymo,argoverse2,tables,dask,mcap,rerun]'
	@$(CHECK_NATIVE)
	@touch $@

demo: $(if $(wildcard $(STAMP)),$(STAMP),$(BASE))
	@echo "Recording, tracking and scoring 20 trials of $(words $(DEMO)) scenarios with two trackers, then a page with replays."
	$(BIN)/pmbm run $(DEMO) --trials 20 --seed $(DEMO_SEED) --jobs 2 --page demo

test: $(STAMP)
	$(BIN)/python -m pytest -n 2 -m "not slow"

gate: $(STAMP)
	$(BIN)/pmbm gate tests/gate.toml --against $(AGAINST) --jobs 2

verify: $(STAMP)
	$(BIN)/python -m pytest -n 2 -m slow --verification reports/verification.json

bench: $(STAMP)
	$(BIN)/python tests/benchmark/bench.py

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

clean:
	rm -rf $(VENV) build
