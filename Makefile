# `make` lists the targets. Everything runs in .venv, which `make setup` builds from constraints.txt.

PYTHON ?= python3
SUITE ?= quick
SEEDS ?= 5
WORKERS ?= 2

BIN := .venv/bin
STAMP := .venv/installed
DOCS_STAMP := .venv/docs-installed
LATEST := .venv-latest
OLDEST := .venv-oldest
PACKAGES := baselines benchmark_envs results sb3_nmp
PYTEST := $(BIN)/pytest -n auto --maxprocesses $(WORKERS)

.DEFAULT_GOAL := help
.PHONY: help setup bench test test-slow test-latest test-oldest leaderboard docs check format clean distclean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 12

setup: $(STAMP) ## install the pinned environment in .venv (again when pyproject or constraints change)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	    echo "Python 3.11 or newer is needed, but '$(PYTHON)' is" \
	        "$$($(PYTHON) --version 2>&1). Name another: make PYTHON=python3.12 setup" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	    echo "'$(PYTHON)' cannot create virtual environments." \
	        "On Debian: apt-get install python3-venv" >&2; exit 1; }
	@echo "Installing the pinned packages in .venv (a minute or more)."
	@$(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	    -e '.[dev,contrib,qd,robotics,robots]'
	@touch $@
	@echo "Installed in .venv."

# One thread a process: the runs themselves are spread over the cores.
bench test test-slow test-latest test-oldest leaderboard docs: export OMP_NUM_THREADS = 1

bench: setup ## run the quick suite over 5 seeds, then print its table and draw its plots
	$(BIN)/nmp-bench run --suite $(SUITE) --seeds $(SEEDS)
	$(BIN)/nmp-bench table --suite $(SUITE)
	$(BIN)/nmp-bench plot --suite $(SUITE)
	@echo "Runs, table and plots: results/runs/$(SUITE)"

test: setup ## tests and doctests, without the slow ones
	$(PYTEST)

test-slow: setup ## the slow, statistical tests alone
	$(PYTEST) -m slow

leaderboard: setup ## verify the leaderboard, do a part of its runs again, and fail where one is worse
	$(BIN)/nmp-bench leaderboard verify
	$(PYTEST) -m leaderboard

# All pins but MuJoCo's, whose newest version is newer than gymnasium-robotics takes.
$(LATEST)/installed: pyproject.toml constraints.txt
	@echo "Installing the newest MuJoCo and the other pinned packages in $(LATEST) (a minute or more)."
	@$(PYTHON) -m venv $(LATEST)
	@grep -v '^mujoco==' constraints.txt > $(LATEST)/constraints.txt
	@$(LATEST)/bin/python -m pip install --quiet --disable-pip-version-check --upgrade \
	    -c $(LATEST)/constraints.txt -e '.[dev,contrib,qd]' 'mujoco>=4'
	@touch $@

test-latest: $(LATEST)/installed ## tests and doctests with the newest MuJoCo, in .venv-latest
	$(LATEST)/bin/pytest -n auto --maxprocesses $(WORKERS)

$(OLDEST)/installed: pyproject.toml constraints-oldest.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || { \
	    echo "The oldest versions have wheels for Python 3.11, but '$(PYTHON)' is" \
	        "$$($(PYTHON) --version 2>&1). Name another: make PYTHON=python3.11 test-oldest" >&2; exit 1; }
	@echo "Installing the oldest versions that pyproject.toml allows in $(OLDEST) (a minute or more)."
	@$(PYTHON) -m venv $(OLDEST)
	@$(OLDEST)/bin/python -m pip install --quiet --disable-pip-version-check --upgrade \
	    -c constraints-oldest.txt -e '.[contrib,dev,robotics]'
	@touch $@

# Warnings are no errors here: old packages are used by newer ones in ways that are deprecated now.
# pyribs, which CMA-ME's example runs with, needs NumPy 2.
test-oldest: $(OLDEST)/installed ## tests and doctests with the oldest dependencies, in .venv-oldest
	$(OLDEST)/bin/pytest -n auto --maxprocesses $(WORKERS) -o filterwarnings=default \
	    --ignore=baselines/quality_diversity

$(DOCS_STAMP): $(STAMP)
	@echo "Installing what builds the documentation in .venv."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

# Pages that hold code are executed, and again only where it has changed.
docs: export PATH := $(CURDIR)/$(BIN):$(PATH)
docs: $(DOCS_STAMP) ## build the documentation; a warning is an error
	$(BIN)/python -m sphinx -W --keep-going -q -b html -c docs . docs/_build/html
	@echo "Open docs/_build/html/index.html"

check: setup ## ruff (lint and format), pyright, and which module may import which
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/lint-imports
	$(BIN)/pyright --warnings

format: setup ## mend what ruff can mend
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

clean: ## remove caches and build artefacts (never results/runs)
	rm -rf build dist docs/_build .hypothesis .pytest_cache .ruff_cache *.egg-info
	find $(PACKAGES) tests -type d -name __pycache__ -prune -exec rm -rf {} +

distclean: clean ## clean, and remove .venv, .venv-latest and .venv-oldest too
	rm -rf .venv $(LATEST) $(OLDEST)
