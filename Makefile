# Two commands for a person: `make demo` and `make test`. Each sets up its own virtual environment.
PYTHON ?= python3
VENV   ?= .venv
BIN     = $(VENV)/bin
STAMP   = $(VENV)/.installed
OUT    ?= demo
CUTS   ?= 10
MINUTES ?= 60
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export PIP_DISABLE_PIP_VERSION_CHECK = 1

# Hundreds of processes are started by the tests; without bytecode each would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE

# pip would compile the fifteen thousand modules of all packages, a minute and more; what is used is compiled when first imported.
INSTALL = install -q --no-compile
# The pip that came with Python may be years old; today's finds out in half of the time which versions go together. Without one go on.
NEW_PIP = install -q --no-compile --upgrade pip

.PHONY: demo docs test test-all lowest lint bench bench-gap rig torture study format clean setup

# Where nothing is set up yet the demo installs what it runs, and no more: neither the tools of tests nor rerun.
demo:
	@test -e $(STAMP) || $(MAKE) $(VENV)/.demo
	$(BIN)/sideslip demo --out $(OUT)

$(VENV)/.demo: pyproject.toml constraints.txt
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	-$(BIN)/python -m pip $(NEW_PIP)
	$(BIN)/python -m pip $(INSTALL) -c constraints.txt -e '.[estimation]'
	@touch $@

# The lowest versions that pyproject.toml declares, of what it names itself, in an environment of their own; then the tests.
lowest:
	$(PYTHON) -m venv $(VENV)-lowest
	$(VENV)-lowest/bin/python -m pip $(INSTALL) packaging 'setuptools>=77'
	$(VENV)-lowest/bin/python tests/support/lowest.py > $(VENV)-lowest/constraints.txt
	$(VENV)-lowest/bin/python -m pip $(INSTALL) -c $(VENV)-lowest/constraints.txt -e '.[dev]'
	$(VENV)-lowest/bin/pytest -q $(PARALLEL) -m "$(ORDINARY) and not long"

# What takes long (tests/long_tests.txt: one test in thirteen, three quarters of the time) is left to CI and to test-all.
# Three processes on two cores: some tests wait for a clock, a port or a page. A file stays in one process: what its tests share is made once.
# Files go out in the order of tests/conftest.py, longest first: the last ones are short, and no core waits for one long file at the end.
ORDINARY = not study and not benchmark
PARALLEL = -n 3 --dist loadfile --no-loadscope-reorder
test: $(STAMP)
	$(BIN)/pytest -q $(PARALLEL) -m "$(ORDINARY)$(if $(CI),, and not long)"

test-all: $(STAMP)
	$(BIN)/pytest -q $(PARALLEL) -m "$(ORDINARY)"

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP)
	$(BIN)/pytest -q -m benchmark -p no:randomly -s tests/benchmarks

bench-gap: $(STAMP)
	$(BIN)/python -m tests.studies.gap_benchmark

# A booted Debian in QEMU, with its plug in our hand: docs/rig.md. Root; skips with its reason where something is missing.
rig: $(STAMP)
	$(BIN)/python -m tests.rig --cuts $(CUTS)

# Fuzz, kills, full disks, two at once, soak: docs/threat-model.md has the last table.
torture: $(STAMP)
	$(BIN)/python -m tests.torture --minutes $(MINUTES)

study: $(STAMP)
	$(BIN)/pytest -q -m study tests

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit("Sideslip needs Python 3.11 or newer; set PYTHON=..." if sys.version_info < (3, 11) else 0)'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	-$(BIN)/python -m pip $(NEW_PIP)
	$(BIN)/python -m pip $(INSTALL) -c constraints.txt -e '.[dev]'
	@$(BIN)/rerun analytics disable >/dev/null 2>&1 || echo 'note: could not switch off rerun analytics'
	@touch $(STAMP)

clean:
	rm -rf $(VENV) build *.egg-info demo

docs: $(STAMP)
	$(BIN)/sphinx-build -W --keep-going -q -b html docs build/docs
	@echo build/docs/index.html
