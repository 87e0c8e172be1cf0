# Every target creates .venv when it is missing and renews it when pyproject.toml or
# constraints.txt has changed. Needed beforehand: Python >= 3.10 with venv, make, git.

PYTHON ?= python3
FLIGHT ?=
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check --no-input

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test fuzz lint regress golden bench samples clean venv

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-9s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(VENV)/.installed  ## Process the sample flight into demo-output/
	@$(BIN)/beamseg run data/samples/arena.mcap --extrinsic 0.071,0.011,0.04 -o demo-output --overwrite

test: $(VENV)/.installed-dev  ## Run the tests
	@$(BIN)/python -m pytest

fuzz: $(VENV)/.installed-dev  ## Put damaged recordings through the commands: make fuzz [SEED=1 INFO=2000 RUN=200]
	@$(BIN)/python -m tests.fuzz --seed $(or $(SEED),1) --info $(or $(INFO),2000) --run $(or $(RUN),200)

lint: $(VENV)/.installed-dev  ## Check style, types and layers
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/mypy
	@$(BIN)/lint-imports

regress: $(VENV)/.installed  ## Process the samples; fail if anything moved from tests/golden
	@$(BIN)/python -m tests.golden.regression

golden: $(VENV)/.installed  ## Make tests/golden anew, where a change is meant, and say what changed
	@$(BIN)/python -m tests.golden.regression --renew

bench: $(VENV)/.installed  ## Measure time and memory beside baselines: make bench [FLIGHT=folder]
	@$(BIN)/python -m benchmarks $(if $(FLIGHT),--flight "$(FLIGHT)")

samples: $(VENV)/.installed  ## Fly data/samples anew
	@$(BIN)/python data/samples/make_samples.py

clean:  ## Remove what was built and written; .venv stays
	@rm -rf build dist demo-output .coverage .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	@find src tests benchmarks data -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamp holds the checkout's path. Scripts in .venv hold it too, so a .venv that was moved, or
# whose Python is gone, is made anew; otherwise it is brought up to date in place.
ifneq ($(shell $(BIN)/python -c 'print(open("$(VENV)/.installed").read())' 2>/dev/null),$(CURDIR))
$(VENV)/.installed: venv
endif

venv:
	@command -v $(PYTHON) >/dev/null || { echo "make: $(PYTHON) is missing; install Python 3.10 or newer, or name one: make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { echo "make: $(PYTHON) is $$($(PYTHON) -V 2>&1), but 3.10 or newer is needed; name one: make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "make: $(PYTHON) cannot create virtual environments; on Debian and Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	@echo "Creating $(VENV) with $$($(PYTHON) -V 2>&1)" >&2
	@$(PYTHON) -m venv --clear $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt
	@echo "Installing beamseg-batch and its libraries (some minutes the first time)" >&2
	@$(PIP) install -c constraints.txt hatchling
	@$(PIP) install -c constraints.txt --no-build-isolation -e .
	@printf '%s\n' "$(CURDIR)" >$@

$(VENV)/.installed-dev: $(VENV)/.installed
	@echo "Installing the tools for tests and checks" >&2
	@$(PIP) install -c constraints.txt --no-build-isolation -e '.[dev]'
	@touch $@
