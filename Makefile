# `make fit` and `make test` need nothing but Python 3.11 or later (with venv), and make.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
OUT ?= runs
# small matrices: more than one BLAS thread only waits for the others
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: fit test lint bench study gap-study clean

fit: $(VENV)/.run
	$(BIN)/bayescal fit data/lrmate200ic-cube --samples 5000 --out $(OUT)/lrmate200ic-cube-fit

test: $(VENV)/.test
	$(BIN)/python -m pytest

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

study: $(VENV)/.test
	$(BIN)/python -m analysis.study

gap-study: $(VENV)/.test
	$(BIN)/python -m analysis.gap_study

bench: $(VENV)/.bench $(VENV)-pybotics/.bench
	$(BIN)/python -m analysis.benchmarks --pybotics $(VENV)-pybotics/bin/python

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.run: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e .
	touch $@

$(VENV)/.test: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[test]"
	touch $@ $(VENV)/.run

$(VENV)/.bench: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[bench]"
	touch $@ $(VENV)/.run

$(VENV)-pybotics/.bench: analysis/benchmarks/requirements-pybotics.txt
	$(PYTHON) -m venv $(VENV)-pybotics
	$(VENV)-pybotics/bin/python -m pip install --quiet -r analysis/benchmarks/requirements-pybotics.txt
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-pybotics runs build dist bench.json
