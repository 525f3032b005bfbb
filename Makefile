# Each target sets up .venv by itself, from constraints.txt; Python 3.11 or newer and make are all that must be there.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
WORKERS ?= 2
BROWSERS := chromium chromium-browser google-chrome google-chrome-stable
BIN := .venv/bin
INSTALLED := .venv/.installed
# --no-compile: Python compiles what is imported, a small part of the packages, when it is imported
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt

# What Python compiles is kept, even if the environment says otherwise: the tests start hundreds of processes, which spend
# half of their time on it without.
unexport PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX := $(CURDIR)/.venv/bytecode

.PHONY: help demo test nightly browser kernels lint docs bench clean
.DEFAULT_GOAL := help

help: ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s%s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo "  PYTHON=python3.12 picks the interpreter, WORKERS=4 the processes of the tests,"
	@echo "  REQUIRE_DATA=1 makes tests fail where real recordings are missing."

demo: $(INSTALLED) ## video -> identified rope -> cast on an emulated drive: a folder of figures, an animation and a report
	$(BIN)/hyperflex demo

PYTEST = $(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal $(if $(filter 1,$(REQUIRE_DATA)),--require-data)

test: $(INSTALLED) browser kernels ## the gate: all tests that take seconds
	$(PYTEST) -m "not nightly"

nightly: $(INSTALLED) browser docs ## all tests, kernels without the compiler, faults by the thousand, the strict site: hours
	$(PYTEST)
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -q tests/core
	HYPERFLEX_FAULTS=150 $(BIN)/python -m pytest -q tests/faults
	$(BIN)/python -m benchmarks.interrupting --seeds 30

browser: # for the tests of pages, which skip without one (and fail in CI, and with REQUIRE_DATA=1)
	@for program in $(BROWSERS); do command -v $$program >/dev/null && exit 0; done; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		echo "Installing chromium for the tests of pages."; \
		{ apt-get update -qq && DEBIAN_FRONTEND=noninteractive \
			apt-get install -y -qq --no-install-recommends chromium; } >/dev/null 2>&1 && exit 0; \
	fi; \
	echo "No browser ($(BROWSERS)): install chromium to run the tests of pages." >&2

kernels: $(INSTALLED) # once for each state of them; each process of the tests would compile those that it needs first
	$(BIN)/hyperflex warm

lint: $(INSTALLED) ## ruff, mypy and import-linter
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache --no-logo

docs: $(INSTALLED) ## the documentation site, in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "Open site/index.html (with search: $(BIN)/python -m http.server --directory site)"

bench: $(INSTALLED) ## speed and accuracy, compared with other simulators in the same run
	$(BIN)/python benchmarks/run.py

clean: ## remove what the other targets made, except .venv
	rm -rf site build dist demo-output .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests docs benchmarks examples -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

$(INSTALLED): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" && $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
		{ echo "No Python 3.11 or newer found. Install one, or name it: make PYTHON=/path/to/python3 ..." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "This Python has no venv module (on Debian and Ubuntu: apt install python3-venv)." >&2; exit 1; }
	@echo "Setting up .venv with the pinned packages: about a minute, once."
	@test -x $(BIN)/pip || $(PYTHON) -m venv .venv
	@$(PIP) hatchling editables
	@$(PIP) --no-build-isolation --editable '.[dev]'
	@touch $@
