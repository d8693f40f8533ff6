# Needs Python 3.11 or newer and make; everything else goes into .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PROGRAM ?= programs/trident.nc
# Two processes for each core: tests wait for four tenths of their time, so with three processes for
# two cores a core has nothing to do for a seventh of the time. A process that has run out of tests
# takes some of another. Each has one thread of linear algebra: further ones wait in a busy loop, and
# take the processor from the tests of the other processes.
PROCESSES := $(shell $(PYTHON) -c 'import os; print((os.cpu_count() or 1) * 2)')
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest
SHARED := -n $(PROCESSES) --dist worksteal

# Without compiled modules each process of a test would compile them again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run test early tested quick soak bench lint format types layers warm docs picture wheel firmware flash simulator clean

# Run a program on the loopback board: make run PROGRAM=programs/pocket.nc
run: $(VENV)/installed
	$(BIN)/cncrun $(PROGRAM)

# Everything that CI checks, with a share of the tests. First the kernels are compiled. Beside it are
# the tests that need none of these kernels, then the linters.
test: $(VENV)/installed-test
	$(MAKE) --jobs=2 warm early lint tested

# Before the others: this process writes the bytecode of all tests, which else each of them would do.
early: $(VENV)/installed-test
	$(PYTEST) -q -m own_code

tested: warm
	$(PYTEST) $(SHARED) -m "not own_code"

# For daily work: the tests of language, model and files, without firmware, browser and long runs.
quick: $(VENV)/installed-test
	$(MAKE) --jobs=2 lint
	$(PYTEST) $(SHARED) tests/gcode tests/machine tests/model tests/outputs tests/report

# All tests, with large amounts of work: those of make test, and those with the marker soak.
soak: $(VENV)/installed-test
	CNC_SOAK=1 $(PYTEST) $(SHARED)

# The documentation site: build/site. A broken link is an error.
docs: $(VENV)/installed-docs
	NO_MKDOCS_2_WARNING=1 DISABLE_MKDOCS_2_WARNING=true $(BIN)/python -m mkdocs build --strict

lint: types format layers

format: $(VENV)/installed-test
	$(BIN)/ruff check
	$(BIN)/ruff format --check

types: $(VENV)/installed-test
	$(BIN)/mypy

layers: $(VENV)/installed-test
	$(BIN)/lint-imports

warm: $(VENV)/installed-test
	$(BIN)/cncrun warm

# Speed of reading, planning and interpolating; how fast the planner's motions are, whether they are legal, what they cost.
bench: $(VENV)/installed-test
	$(BIN)/python -m benchmarks.startup
	$(BIN)/python -m benchmarks.programs
	$(BIN)/python -m benchmarks.language
	$(BIN)/python -m benchmarks.sampled
	$(BIN)/python -m benchmarks.planner --whole
	$(BIN)/python -m benchmarks.optimum_cases
	$(BIN)/python -m benchmarks.holds --count 80
	$(BIN)/python -m benchmarks.segments
	$(BIN)/python -m benchmarks.interpolators
	$(BIN)/python -m benchmarks.checking
	$(BIN)/python -m benchmarks.view
	$(BIN)/python -m benchmarks.history

# A wheel with compiled kernels, for this system and version of Python and any of its processors: dist/*.whl.
wheel: $(VENV)/installed-test
	NUMBA_CPU_NAME=generic NUMBA_CACHE_DIR=$(CURDIR)/build/compiled $(BIN)/cncrun warm
	CNC_COMPILED=build/compiled $(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .

# The stepper board: build/firmware/stepper.hex, and onto an Uno with make flash PORT=/dev/ttyUSB0 (gcc-avr, avr-libc, avrdude).
firmware flash:
	$(MAKE) -C firmware $(subst firmware,all,$@)

# The same firmware in simavr on a pseudo-terminal, for --port (libsimavr-dev).
simulator:
	$(MAKE) -C firmware simulator
	build/firmware/simulator build/firmware/stepper.elf

# The pictures of README and documentation.
picture: $(VENV)/installed-view
	$(BIN)/python -m docs.make_picture

$(VENV)/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	touch $@

# Stamps: an install is repeated only when what it depends on has changed.
$(VENV)/installed: $(VENV)/python pyproject.toml
	@echo 'installing cnc and what it needs into $(VENV) (once; numba and its compiler are about 150 MB)'
	$(BIN)/python -m pip install --quiet --progress-bar on --disable-pip-version-check --no-compile -e .
	touch $@

$(VENV)/installed-test: $(VENV)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test]'
	touch $@ $(VENV)/installed

$(VENV)/installed-docs: $(VENV)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	touch $@ $(VENV)/installed

$(VENV)/installed-view: $(VENV)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[view]'
	touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV) build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
