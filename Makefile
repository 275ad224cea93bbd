# Two commands do everything on a fresh Debian 12 or Ubuntu machine with Python 3.11:
# `make demo` and `make test`. `make help` lists the rest.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
TRIED  := $(VENV)/.tried
# Errors alone: pip warns of every package that one of a machine's own indexes does not have.
INSTALL := $(BIN)/python -m pip install --quiet --quiet --no-cache-dir
# Benchmarks that ask for folders or pictures are called by hand.
BY_HAND := atlas_rerender atlas_session geometry_pictures likeness registration_pictures \
  template_loops_picture
BENCHMARKS = $(filter-out $(BY_HAND) stale, $(notdir $(basename $(shell grep -l '__name__ == "__main__"' benchmarks/*.py))))
# Processes that share the tests. A third one on two cores fills waits (a device's answer, a deadline)
# and saves a tenth of the time, but a browser and a camera's deadline were then late.
WORKERS ?= 2
# Waiting threads sleep instead of spinning: the test workers share the cores.
export OMP_WAIT_POLICY := PASSIVE
# Every step and many tests start a process: they need not compile this code again.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: demo test test-fast check bench bench-stale setup lock clean help

demo: $(TRIED) ## the main job on the simulated stage; ends with build/demo/report.html
	$(BIN)/python -m demo.run --out build/demo

# One thread a worker: two of each were a tenth slower.
test: export OMP_NUM_THREADS := 1
test: $(READY) ## all tests
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal --durations 8

test-fast: export OMP_NUM_THREADS := 1
test-fast: $(READY) ## the tests of all files but the slow ones (tests/slow.txt): three minutes
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "not slow"

check: $(READY) ## lint, types, import arrows, the firmware's warnings
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	@if command -v gcc >/dev/null; then $(MAKE) -C firmware check; else echo "no gcc: no firmware"; fi

bench: $(READY) ## every benchmark; tables go to benchmarks/RESULTS.md; keeps 23 GB (CONTRIBUTING.md)
	for name in $(BENCHMARKS); do $(BIN)/python -m benchmarks.$$name || exit 1; done

bench-stale: $(READY) ## tables of benchmarks/RESULTS.md that are older than the code they measure
	$(BIN)/python -m benchmarks.stale

setup: $(TRIED) ## system packages and the virtual environment, pinned; a tiny capture as a trial

$(READY): requirements.lock requirements-faces.txt pyproject.toml scripts/system-packages
	PYTHON=$(PYTHON) scripts/system-packages
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --upgrade pip
	@[ -e $(READY) ] || scripts/disk-space $(VENV)
	@echo "Installing the packages of requirements.lock into $(VENV): a minute to five, without a word."
	$(INSTALL) --requirement requirements.lock
	$(INSTALL) --no-deps --require-hashes --requirement requirements-faces.txt
	$(INSTALL) --no-deps --editable .
	@touch $(READY)
	@echo "Ready. \`. $(BIN)/activate\` brings the commands into this shell; README.md says what to run."

$(TRIED): $(READY)
	@echo "Trying the installation by a tiny capture, which compiles the numeric kernels: five minutes."
	@mkdir -p build
	@$(BIN)/python -m demo.run --tiny --out build/trial >build/trial.log 2>&1 || \
	  { tail -n 40 build/trial.log; echo "The trial failed; build/trial.log has all of its output." >&2; exit 2; }
	@touch $(TRIED)

lock: $(READY) ## resolve pyproject.toml again into requirements.lock
	scripts/lock $(BIN)

clean: ## remove what demo and tests made (not the virtual environment)
	rm -rf build .pytest_cache .hypothesis .mypy_cache .ruff_cache .import_linter_cache

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-11s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
