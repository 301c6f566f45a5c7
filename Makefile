# `make demo` and `make test` set up what they need in .venv, and nothing outside this folder.
# Where a ROS installation is sourced they use that one, in an environment of its own.
VENV := .venv$(addprefix -,$(ROS_DISTRO))
OLDEST := $(VENV)-oldest
VERSIONS := 3.12 3.11 3.13

# Both cores, and one process more, as tests of nodes wait half of the time; one file's tests stay
# in one process, which has a ROS domain to itself.
PYTEST := -m pytest -n 3 --dist loadfile
SOURCES := setup.py setup.cfg pyproject.toml tools/environment.sh

# Where somebody wants no bytecode kept, each of the many processes would compile all it imports,
# which takes twice as long as the rest of its start.
unexport PYTHONDONTWRITEBYTECODE

# What is multiplied is too small for several threads, and the cores are taken.
test test-oldest: export OPENBLAS_NUM_THREADS := 1

.DEFAULT_GOAL := help
.PHONY: help demo test test-oldest lint bench reliability clean

help:  ## show this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1\t\2/p' Makefile | expand -t 20

demo: $(VENV)/demo.stamp  ## 40 vehicles find themselves over DDS; writes a bag and report.html
	@$(VENV)/bin/demo

test: $(VENV)/test.stamp  ## the test suite with coverage, then the static checks
	@$(VENV)/bin/python $(PYTEST) --cov
	@$(MAKE) --no-print-directory lint

test-oldest: $(OLDEST)/test.stamp  ## the same with the oldest supported versions, but accuracy
	@$(OLDEST)/bin/python $(PYTEST) -m 'not accuracy'

lint: $(VENV)/test.stamp  ## the static checks alone: style, docstrings, types
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/mypy

bench: $(VENV)/bench.stamp  ## how fast it is beside peers and limits; writes docs/performance.md
	@$(VENV)/bin/python test/benchmark/run.py --out docs/performance.md

reliability: $(VENV)/test.stamp  ## what it stands and what is lost; writes docs/reliability.md
	@$(VENV)/bin/python test/reliability/run.py --out docs/reliability.md

clean:  ## remove the environments and what the tools left behind
	@rm -rf .venv* .coverage .coverage.* .hypothesis .mypy_cache .pytest_cache \
	    .ruff_cache build install log *.egg-info
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Installed anew only when what is to be installed has changed.
$(VENV)/demo.stamp: $(SOURCES)
	@tools/environment.sh $(VENV) '$(VERSIONS)' plot
	@touch $@

$(VENV)/test.stamp: $(SOURCES)
	@tools/environment.sh $(VENV) '$(VERSIONS)' plot,test,check
	@touch $(VENV)/demo.stamp $@

$(VENV)/bench.stamp: $(SOURCES)
	@tools/environment.sh $(VENV) '$(VERSIONS)' plot,test,check,bench
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps \
	    'particles>=0.4,<0.5'
	@touch $(VENV)/demo.stamp $(VENV)/test.stamp $@

$(OLDEST)/test.stamp: $(SOURCES) test/oldest.txt
	@tools/environment.sh $(OLDEST) '3.12 3.11' plot,test --constraint test/oldest.txt
	@touch $@
