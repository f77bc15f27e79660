# Two commands do everything on a machine that has Python >= 3.11 and can reach a package index:
#   make demo   set up .venv, estimate the shipped population, say where the report is
#   make test   set up .venv, run the tests
SHELL := /bin/bash
VENV ?= .venv
BIN := $(VENV)/bin
OUT ?= out/demo

# The first interpreter that is new enough; PYTHON=... chooses another.
PYTHON ?= $(shell for p in python3 python3.11 python3.12 python3.13 python; do \
  if $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then echo $$p; break; fi; done)

.PHONY: demo test test-long test-ci test-all bench lint docs format clean help
.DEFAULT_GOAL := help

help:
	@echo "make demo      estimate the shipped population of 71 virtual fingertips; the report goes to $(OUT)"
	@echo "make test      run the tests, but for those that take long (about a quarter of an hour)"
	@echo "make test-long run those (about as long)"
	@echo "make test-ci   run the slow statistical checks that CI runs after them"
	@echo "make test-all  run every slow check too (about an hour)"
	@echo "make bench     speed against peers, in one run (about an hour; leave the machine alone)"
	@echo "make docs      build the documentation, its notebooks executed; out/docs/index.html"
	@echo "make lint      ruff, mypy and the import contracts"
	@echo "make clean     remove what these commands made"

$(BIN)/python:
	@if [ -z "$(PYTHON)" ]; then echo "error: no Python >= 3.11 was found; install one, or name it: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)"; exit 1; fi
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "error: $(PYTHON) has no venv module; install it (Debian: apt install python3-venv)"; exit 1; }
	@echo "making $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)

# One stamp for each set of extras, so that `make demo` installs no more than it needs.
define install
	@echo "installing $(1)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e "$(1)" || { echo "error: installing failed; is a package index reachable? (python -m pip config list)"; exit 1; }
	@touch $@
endef

$(VENV)/.run: $(BIN)/python pyproject.toml
	$(call install,.)

$(VENV)/.test: $(BIN)/python pyproject.toml
	$(call install,.[test$(comma)oracle$(comma)intake])
	@touch $(VENV)/.run

$(VENV)/.lint: $(BIN)/python pyproject.toml
	$(call install,.[test$(comma)lint])
	@touch $(VENV)/.run

$(VENV)/.bench: $(BIN)/python pyproject.toml
	$(call install,.[test$(comma)oracle$(comma)bench])
	@touch $(VENV)/.run

$(VENV)/.docs: $(BIN)/python pyproject.toml
	$(call install,.[docs$(comma)intake$(comma)design])
	@touch $(VENV)/.run

comma := ,

demo: $(VENV)/.run
	@$(BIN)/bayes-impedance run data/fingertip_71 -o $(OUT)
	@echo "open it: file://$(abspath $(OUT))/report.html"

test: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not slow and not long" $(PYTEST_ARGS)

test-long: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "long and not slow" $(PYTEST_ARGS)

test-ci: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "slow and ci" $(PYTEST_ARGS)

test-all: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 --dist loadfile $(PYTEST_ARGS)

bench: $(VENV)/.bench
	$(BIN)/python benchmarks/run.py $(BENCH_ARGS)

lint: $(VENV)/.lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache --config pyproject.toml

docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -W --keep-going -b html docs out/docs
	@echo "open it: file://$(abspath out/docs)/index.html"

format: $(VENV)/.lint
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) out .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
