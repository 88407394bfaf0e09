# Each target sets up what it needs: Python 3.11+ is all a fresh machine must have.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
OUT ?= srvs-cell-demo
# contrib and plain OpenCV share a folder: the peers' environment is their own
PEERS := .benchmarks/peers
PEERS_STAMP := $(PEERS)/.installed
PLAN_PEERS := .benchmarks/plan-peers
PLAN_PEERS_STAMP := $(PLAN_PEERS)/.installed

.PHONY: help venv demo test test-vm check wire-peers bench bench-peers bench-plan-peers format clean

help:
	@echo "make demo   the paper's whole job on a simulated cell, with a report in $(OUT)/"
	@echo "make test   every test"
	@echo "make test-vm  the service and the camera driver under a real kernel and systemd, in a virtual machine"
	@echo "make check  ruff, mypy strict, import-linter"
	@echo "make wire-peers  drivers and doubles judged by clients and servers that others wrote"
	@echo "make bench  the figures of docs/benchmarks.md"
	@echo "make bench-peers  our planes beside other stereo matchers, in an environment of their own"
	@echo "make bench-plan-peers  our planner beside OR-Tools CP-SAT, in an environment of their own"

$(STAMP): requirements-dev.txt pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("srvs_cell needs Python 3.11 or newer; set PYTHON=") if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements-dev.txt
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch $@

venv: $(STAMP)

demo: $(STAMP)
	$(BIN)/srvs-cell demo --objects 5 --out $(OUT)

test: $(STAMP)
	$(BIN)/python -m pytest -n 2

test-vm: $(STAMP)
	tests/vm/run.sh

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

wire-peers: $(STAMP)
	$(BIN)/python -m tests.peers .benchmarks/wire-peers

bench: $(STAMP)
	$(BIN)/python benchmarks/run_all.py

$(PEERS_STAMP): benchmarks/peers-requirements.txt
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install --quiet -r $<
	touch $@

bench-peers: $(PEERS_STAMP)
	OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(PEERS)/bin/python -m benchmarks.peers

$(PLAN_PEERS_STAMP): benchmarks/plan-peers-requirements.txt
	$(PYTHON) -m venv $(PLAN_PEERS)
	$(PLAN_PEERS)/bin/python -m pip install --quiet -r $<
	touch $@

bench-plan-peers: $(PLAN_PEERS_STAMP)
	$(PLAN_PEERS)/bin/python -m benchmarks.plan_peers

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) .vm .mypy_cache .ruff_cache .pytest_cache .hypothesis
