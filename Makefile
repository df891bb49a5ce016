# `make run` and `make test` do all the set-up themselves; they need Python 3.11 or later and make, nothing else.

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
# Further flags for the run, for example: make run ARGS="--dataset kinder-gator --task adult:child"
ARGS   ?=
# A test worker computes on one thread: numerical libraries that each take all cores stand in one another's way.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
# Test workers: as many as there are cores, at most 8.
WORKERS ?= $(shell n=$$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 1); [ $$n -gt 8 ] && n=8; echo $$n)

.DEFAULT_GOAL := help
.PHONY: help install run pictures test test-slow lint format speed fuzz audit clean

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

install: $(VENV)/.installed  ## Make .venv with the suite and everything its tests need

$(VENV)/.installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and f"Python 3.11 or later is needed, and $(PYTHON) is {sys.version.split()[0]}: make PYTHON=python3.11 ...")'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "installing into $(VENV) (a few minutes the first time)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt setuptools
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt --no-build-isolation -e '.[test]'
	@touch $@

run: install  ## Compare all methods on the embedded data and say where the report is
	@$(BIN)/python -m benchmark run --methods all $(ARGS)

pictures: install  ## Draw the README's pictures anew, from the run on synthetic data
	@$(BIN)/python -m benchmark run --methods all --quiet
	@$(BIN)/python -m benchmark metrics-check --quiet
	@$(BIN)/python docs/pictures.py runs/synthetic-adult-child runs/metrics-check

lint: install  ## Style, types and layers
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

format: install  ## Put the sources in shape
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

test: lint  ## Lint, layer check and the test suite
	@$(ONE_THREAD) $(BIN)/python -m pytest -n $(WORKERS)

test-slow: install  ## The tests that take minutes
	@$(ONE_THREAD) $(BIN)/python -m pytest -n $(WORKERS) -m slow

$(VENV)/.peers: $(VENV)/.installed
	@echo "installing the libraries that ours are timed against"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt --no-build-isolation -e '.[peers]'
	@touch $@

speed: $(VENV)/.peers  ## Time the suite beside other libraries, in one run; the table is kept in speed.md and speed.csv
	@$(BIN)/python tests/speed/run.py --table speed.md --table speed.csv

# Seconds of fuzzing, shared by all readers.
FUZZ_SECONDS ?= 600

$(VENV)/.fuzz: $(VENV)/.installed
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt --no-build-isolation -e '.[fuzz]'
	@touch $@

fuzz: $(VENV)/.fuzz  ## Feed every reader with spoiled files, guided by coverage, for FUZZ_SECONDS
	@$(BIN)/python tests/fuzz/fuzz.py --seconds $(FUZZ_SECONDS)

audit:  ## Look up known vulnerabilities of the pinned versions; needs the network
	@test -x $(VENV)/audit/bin/pip-audit || { $(PYTHON) -m venv $(VENV)/audit && \
		$(VENV)/audit/bin/python -m pip install --quiet --disable-pip-version-check 'pip-audit==2.10.1'; }
	@sed 's/ *#.*//' constraints.txt > $(VENV)/audit/pins.txt
	@$(VENV)/audit/bin/pip-audit --strict --no-deps --disable-pip --progress-spinner off -r $(VENV)/audit/pins.txt || \
		{ echo "make audit failed: either vulnerable versions are listed above, or the service of advisories was not reached and nothing was checked" >&2; exit 1; }

clean:  ## Remove .venv and tool caches; runs/ is kept
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache *.egg-info
