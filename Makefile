# Everything runs in .venv, which is made when needed and kept.  `make help` lists the targets.
# Paths are relative throughout, so that the checkout may lie anywhere, a path with spaces included.

PYTHON ?= python3
JOBS ?= 2
ARGS ?=
# A browser for the tests of report.html; by default the one in the PATH.
CHROMIUM ?=
export CHROMIUM
# The files that can be run; the others are shared by these.
BENCH ?= $(patsubst benchmarks/%.py,%,$(shell grep -l __main__ benchmarks/*.py))

VENV := .venv
PY := $(VENV)/bin/python
PIP_INSTALL := $(PY) -m pip install --no-compile --disable-pip-version-check -c constraints.txt

# Each test process gets one thread: $(JOBS) of them share the machine.
TEST_ENV := OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MPLBACKEND=Agg \
    PATH="$$PWD/$(VENV)/bin:$$PATH"
PYTEST := $(TEST_ENV) $(PY) -m pytest -n $(JOBS) --dist worksteal

COMPILE := from edtorch.search import program, striking_program; program.kernels(); \
    striking_program.striking_kernels()

.PHONY: help ride kernels test test-long test-browser test-paper test-slurm browser slurm check format bench \
    paper tasks env dev clean distclean
.DEFAULT_GOAL := help

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1|\2/p' Makefile | \
	while IFS='|' read -r name text; do printf '%-20s %s\n' "$$name" "$$text"; done
	@echo '  ARGS="..." adds arguments: make ride ARGS="seed=7 seeds=16", make test ARGS="-k bicycle"'
	@echo '  PYTHON=python3.12 picks the interpreter of a new environment'

ride: $(VENV)/.core  ## learn to ride a bicycle (the main job)
	$(VENV)/bin/edtorch-train experiment=bicycle $(ARGS)

kernels: $(VENV)/.dev  ## compile the kernels of the searches ahead of the tests
	EDTORCH_CACHE=.pytest_cache/d/kernels $(PY) -c "$(COMPILE)"

test: $(VENV)/.dev  ## all tests but the long ones
	$(PYTEST) $(ARGS)

test-long: $(VENV)/.dev  ## all kinds of kernels; killed runs; the results in runs/reference
	$(PYTEST) -m "reference or long" $(ARGS)

test-browser: $(VENV)/.dev browser  ## the tests of report.html in headless Chromium
	$(PYTEST) -m browser $(ARGS)

test-paper: $(VENV)/.paper $(VENV)/.dev  ## the test of make paper quick=1, for every night
	$(PYTEST) -m paper -o faulthandler_timeout=3600 $(ARGS)

test-slurm: $(VENV)/.dev slurm  ## runs on a SLURM of this machine, for root
	$(TEST_ENV) $(PY) -m pytest -m slurm -o faulthandler_timeout=1800 $(ARGS)

# A page is checked where it is read, and no wheel brings a browser: Debian's package does, for root.
browser:
	@for name in "$(CHROMIUM)" chromium chromium-browser google-chrome; do \
	    command -v "$$name" >/dev/null && exit 0; \
	done; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && \
	    DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium; \
	else \
	    echo "no Chromium: install it, or name one: make test-browser CHROMIUM=PATH" >&2; exit 1; \
	fi

# Debian's packages bring it, for root; elsewhere the tests are skipped and say why.
slurm:
	@if ! command -v slurmctld >/dev/null && [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && \
	    DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends slurm-wlm munge; \
	fi

check: $(VENV)/.dev  ## format, lint, types
	$(PY) -m ruff format --check .
	$(PY) -m ruff check .
	$(PY) -m pyright

format: $(VENV)/.dev  ## put the sources into the format that check wants
	$(PY) -m ruff check --fix-only --quiet .
	$(PY) -m ruff format .

bench: $(VENV)/.bench  ## speed, one file per question; BENCH="tick unroll" picks some
	@set -e; for name in $(BENCH); do \
	    echo "== $$name"; OMP_NUM_THREADS=1 $(PY) -m "benchmarks.$$name" $(ARGS); \
	done

# Cells that are there are kept: it can be stopped and continued.
paper: $(VENV)/.paper  ## the paper, rerun into runs/reference/paper (hours); quick=1: in minutes
	OMP_NUM_THREADS=1 $(PY) -m studies.rerun --jobs $(JOBS) $(if $(quick),--quick) $(ARGS)

tasks: $(VENV)/.dev  ## searches on the standard tasks into runs/reference/tasks (an hour)
	OMP_NUM_THREADS=1 $(PY) -m studies.tasks --jobs $(JOBS) $(if $(quick),--quick) $(ARGS)

env: $(VENV)/.core  ## the environment, with edtorch in it
dev: $(VENV)/.dev  ## the same with the tools of a developer

clean:  ## remove caches and build artefacts; runs and .venv stay
	rm -rf build dist ./*.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean  ## the same and .venv
	rm -rf $(VENV)

# The environment.  $(VENV)/.place holds the folder it was made in.  One that was only half made, has
# lost its interpreter, or came here from another folder is made anew; a sound one is kept.

SOUND := $(shell $(PY) -c 'import pip, sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && \
    [ "$$(cat $(VENV)/.place 2>/dev/null || pwd -P)" = "$$(pwd -P)" ] && echo yes)

ifeq ($(SOUND),yes)
$(VENV)/.place:
	@pwd -P > $@
else
.PHONY: anew
$(VENV)/.place: anew
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	    is=$$("$(PYTHON)" -c 'import platform; print(platform.python_version())' 2>/dev/null || \
	        echo missing); \
	    echo "edtorch needs Python 3.11 or later, but $(PYTHON) is $$is;" \
	        "name another one: make PYTHON=python3.12 ..." >&2; exit 1; }
	rm -rf $(VENV)
	"$(PYTHON)" -m venv $(VENV)
	@pwd -P > $@
endif

# A stamp is written after pip has succeeded, so that a second call installs nothing.
$(VENV)/.core: pyproject.toml constraints.txt $(VENV)/.place
	@rm -f $@
	$(PIP_INSTALL) -e .
	@touch $@

$(VENV)/.dev: $(VENV)/.core
	@rm -f $@
	$(PIP_INSTALL) -e ".[dev]"
	@touch $@

# With the peers that the benchmarks compare with.
$(VENV)/.bench: $(VENV)/.core
	@rm -f $@
	$(PIP_INSTALL) -e ".[bench]"
	@touch $@

# With the arm and the rivals of other people.
$(VENV)/.paper: $(VENV)/.core
	@rm -f $@
	$(PIP_INSTALL) -e ".[cardea,rivals]"
	@touch $@
