# Each target does its own set-up in .venv; python3 (3.11 or newer, with venv), git and make suffice.
PYTHON ?= python3
DATA ?= qube-servo2
OUT ?= results/reproduce
DEMO ?= results/demo
SEEDS ?= 1
MINUTES ?= 5
TESTS ?= not thorough
SEED ?= 0
BIN := .venv/bin

.DEFAULT_GOAL := help
.PHONY: help install demo reproduce docs test test-all test-browser test-newest-jax check torture bench clean

help:
	@echo "make install     the package and its command in .venv"
	@echo "make demo        the whole job on a simulated twin, offline, about 2 minutes (DEMO=$(DEMO))"
	@echo "make reproduce   the paper's results (DATA=FOLDER OUT=$(OUT) SEEDS=$(SEEDS))"
	@echo "make docs        the documentation as pages, its tutorials run (results/docs/site/index.html)"
	@echo "make bench       speed against PyTorch, plain JAX and scipy (DATA=FOLDER; 'bench' extra)"
	@echo "make test        linter, type checker, layers, tests"
	@echo "make test-all    the same, with the tests that are marked 'thorough'"
	@echo "make test-browser  the report in Chromium, which has to be installed ('browser' extra)"
	@echo "make test-newest-jax  what JAX compiles, with the newest JAX for PYTHON (.venv-newest)"
	@echo "make torture     kills, damaged inputs, faults, load for about MINUTES=$(MINUTES) (SEED=$(SEED))"

install: .venv/installed

demo: .venv/installed
	$(BIN)/tustinnet demo --out $(DEMO) --overwrite

reproduce: .venv/installed
	$(BIN)/tustinnet reproduce --data $(DATA) --out $(OUT) --seeds $(SEEDS)

docs: .venv/installed-docs
	$(BIN)/python docs/make.py

# linter, types and layers run beside the tests, and say something only where they fail; a worker
# takes tests that follow one another (worksteal), which share fits and compiled programs; bytecode
# is kept wherever this runs: of the hundreds of modules that workers and processes of tests import
test: .venv/installed-dev
	@$(MAKE) --no-print-directory check > .venv/check.log 2>&1 & check=$$!; \
	PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -q -n auto --dist worksteal -m "$(TESTS)"; tests=$$?; \
	wait $$check || { cat .venv/check.log; exit 1; }; exit $$tests

# a variable of a target is one of what it needs, too
test-all: TESTS =
test-all: test

test-browser: .venv/installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[browser]'
	$(BIN)/pytest -q -rs tests/report/test_page_in_browser.py

# what JAX compiles, and what reads its programs; packages that follow JAX are the newest too
test-newest-jax:
	test -x .venv-newest/bin/python || $(PYTHON) -m venv .venv-newest
	grep -vE '^(jax|jaxlib|equinox|optax|diffrax|lineax|optimistix)==' constraints.txt > .venv-newest/constraints.txt
	.venv-newest/bin/python -m pip install --quiet --disable-pip-version-check --upgrade \
		-c .venv-newest/constraints.txt jax equinox optax diffrax -e '.[dev]'
	.venv-newest/bin/python -c 'import jax; print("JAX", jax.__version__)'
	.venv-newest/bin/pytest -q -n auto --dist worksteal tests/engine tests/program tests/simulate tests/families tests/fitting

check: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports

# stops by itself; results/torture.json has what was found, docs/explanation/reliability.md says what is tried
torture: .venv/installed-dev
	$(BIN)/python -m tests.torture --minutes $(MINUTES) --seed $(SEED)

bench: .venv/installed-bench
	$(BIN)/python benchmarks/training.py compare $(DATA)
	$(BIN)/python benchmarks/training.py seeds $(DATA)
	$(BIN)/python benchmarks/training.py windows $(DATA)
	$(BIN)/python benchmarks/identification.py time $(DATA)
	$(BIN)/python benchmarks/identification.py scipy $(DATA)

.venv/installed-bench: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	@touch $@

.venv/installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "tustinnet needs Python 3.11 or newer: make PYTHON=python3.11"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

.venv/installed-dev: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

.venv/installed-docs: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

clean:
	rm -rf .venv .venv-newest results
