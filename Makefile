# Each target does its own set-up in .venv; python3 (3.11 or newer, with venv) and make are all it takes.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
EXTRAS := dev,synth,export,view,cluster
# Two worker processes; more only fight for memory on small machines.
WORKERS ?= 2

.DEFAULT_GOAL := help
.PHONY: help venv docs demo test test-slow mutants lint format bench clean

help:
	@echo "make demo       synthesise a session, run the pipeline on it, score it: out/demo/"
	@echo "make test       all tests but the slow ones (ARGS=... goes to pytest)"
	@echo "make test-slow  the slow tests"
	@echo "make mutants    plant one-line mistakes in the numerical core and see that tests notice them (slow)"
	@echo "make lint       ruff (rules and format) and mypy"
	@echo "make format     let ruff format the code"
	@echo "make docs       build the documentation into out/site/index.html"
	@echo "make bench      the speed measures of eval.bench"
	@echo "make venv       only prepare the environment in $(VENV) (PYTHON=python3.12 chooses another Python)"
	@echo "make clean      remove caches and out/; the environment stays"

venv: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null 2>&1 || { \
	  echo "$(PYTHON) was not found. Install Python 3.11 or newer (Debian, Ubuntu: apt install python3 python3-venv)," \
	       "or name another one: make venv PYTHON=python3.12" >&2; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "$$($(PYTHON) --version) is too old: Python 3.11 or newer is needed. If you have one under another name:" \
	       "make venv PYTHON=python3.12" >&2; exit 2; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
	  echo "$(PYTHON) cannot make virtual environments. Debian, Ubuntu: apt install python3-venv" >&2; exit 2; }
	@echo "Preparing $(VENV) with $$($(PYTHON) --version); this takes two or three minutes, once"
	@rm -f $@
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[$(EXTRAS)]" || { \
	  echo "The packages could not be installed; pip says why above. Run the same command again when it is mended." >&2; \
	  exit 2; }
	@$(BIN)/mocap warm-up
	@touch $@
	@echo "Ready: $(BIN)/mocap --help"

# The packages that build pages are no part of `make venv`.
DOCS_STAMP := $(VENV)/.installed-docs

$(DOCS_STAMP): $(STAMP)
	@echo "Adding what builds the pages; this takes half a minute, once"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[docs]" || { \
	  echo "The packages could not be installed; pip says why above. Run the same command again when it is mended." >&2; \
	  exit 2; }
	@touch $@

docs: $(DOCS_STAMP)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "Open out/site/index.html in a browser"

demo: $(STAMP)
	@$(BIN)/mocap demo

test: $(STAMP)
	@$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m "not slow" $(ARGS)

test-slow: $(STAMP)
	@$(BIN)/python -m pytest -m slow --timeout 3600 $(ARGS)

mutants: $(STAMP)
	@$(BIN)/python -m eval.mutants $(ARGS)

lint: $(STAMP)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

format: $(STAMP)
	@$(BIN)/ruff check --fix --quiet .
	@$(BIN)/ruff format .

bench: $(STAMP)
	@$(BIN)/python -m eval.bench --gate $(ARGS)

clean:
	@rm -rf out .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find mocap eval tests -name __pycache__ -type d -prune -exec rm -rf {} +
	@echo "Removed caches and out/. To remove the environment too: rm -rf $(VENV)"
