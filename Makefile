# `make fit` and `make test` need nothing but Python 3.11 or later (with venv), and make.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
OUT ?= runs
# of `make blind`, and NOTE: when and at which commit thresholds were frozen
WORLDS ?= 400
SEED ?= 2026
WORKERS ?= 2
# cases of `make fuzz`
N ?= 10000
# arguments of pytest: `make test TESTS="tests/robots -k urdf"`
TESTS ?=
# small matrices: more than one BLAS thread only waits for the others
export OPENBLAS_NUM_THREADS ?= 1
# tests start many processes, each with hundreds of modules that would be compiled anew
unexport PYTHONDONTWRITEBYTECODE

.PHONY: fit test notebooks test-all fuzz lint bench benchmark study calibration-checks own-sessions knock-out blind docs package-check clean

fit: $(VENV)/.run
	$(BIN)/bayescal fit data/lrmate200ic-cube --samples 5000 --out $(OUT)/lrmate200ic-cube-fit

test: $(VENV)/.test
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal $(TESTS)

# the long notebooks and examples, from top to bottom; the suite runs the others
notebooks: $(VENV)/.test
	$(BIN)/python -m pytest -m notebook tests/analysis/test_notebooks.py

# `make test` on every supported Python that the machine has, each with an environment of its own
test-all:
	$(PYTHON) -m analysis.every_python --tests "$(TESTS)"

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# the site in `site/`; a warning is an error
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet

study: $(VENV)/.test
	$(BIN)/python -m analysis.study

# ranks of true values, joint and interval coverage: half an hour; a stopped run is continued
calibration-checks: $(VENV)/.test
	$(BIN)/python -m analysis.calibration_checks

# sessions of real arms, a folder each
REAL ?= ../shared/data/real
knock-out: $(VENV)/.test
	$(BIN)/python -m analysis.knock_out --real $(REAL) --out docs/knock_out.md --workers $(WORKERS)

# damaged input: no traceback, no hang, no wrong number in silence; goes on where it stopped
fuzz: $(VENV)/.test
	$(BIN)/python -m analysis.fuzz --cases $(N) --seed $(SEED) --workers $(WORKERS) --out $(OUT)/fuzz

own-sessions: $(VENV)/.test
	$(BIN)/python -m analysis.own_sessions

# builds and installs both distributions in empty environments
package-check: $(BIN)/python
	$(BIN)/python -m analysis.package_check

# what was interrupted goes on where it stopped; answers are given once
blind: $(VENV)/.test
	$(BIN)/python -m analysis.blind make --worlds $(WORLDS) --seed $(SEED) --workers $(WORKERS) --out $(OUT)/blind
	test -f $(OUT)/blind/answers.json || $(BIN)/python -m analysis.blind run $(OUT)/blind --workers $(WORKERS)
	$(BIN)/python -m analysis.blind score $(OUT)/blind --page docs/blind.md $(if $(NOTE),--note "$(NOTE)")

bench: $(VENV)/.bench $(VENV)-pybotics/.bench $(VENV)-figaroh/.bench
	$(BIN)/python -m analysis.benchmarks --pybotics $(VENV)-pybotics/bin/python --figaroh $(VENV)-figaroh/bin/python

# calibration tools compared on the same tasks; entries that are there are kept. Without the folder REAL: simulated tasks alone
PEERS = pybotics figaroh robotkinecal boosting
benchmark: $(VENV)/.test $(PEERS:%=$(VENV)-%/.bench)
	$(BIN)/python -m analysis.contest --environments $(VENV)- --out $(OUT)/contest --real $(REAL) --page docs/contest.md

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.run: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[interactive]'
	touch $@

$(VENV)/.test: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[test]"
	touch $@ $(VENV)/.run

$(VENV)/.docs: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[docs]"
	touch $@ $(VENV)/.run

$(VENV)/.bench: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[bench]"
	touch $@ $(VENV)/.run

$(VENV)-%/.bench: analysis/benchmarks/requirements-%.txt
	$(PYTHON) -m venv $(VENV)-$*
	$(VENV)-$*/bin/python -m pip install --quiet -r $<
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-* runs build dist site bench.json
