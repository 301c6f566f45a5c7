# `make demo` and `make test` set up what they need in .venv, and nothing outside this folder.

# Both cores; one file's tests stay in one process, which has a ROS domain to itself.
PYTEST := -m pytest -n 2 --dist loadfile
SOURCES := setup.py setup.cfg pyproject.toml tools/environment.sh

.DEFAULT_GOAL := help
.PHONY: help demo test test-oldest lint clean

help:  ## show this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1\t\2/p' Makefile | expand -t 20

demo: .venv/demo.stamp  ## 40 vehicles find themselves over DDS; writes a bag and report.html
	@.venv/bin/demo

test: .venv/test.stamp  ## the test suite with coverage, then the static checks
	@.venv/bin/python $(PYTEST) --cov
	@$(MAKE) --no-print-directory lint

test-oldest: .venv-oldest/test.stamp  ## the test suite with the oldest supported versions
	@.venv-oldest/bin/python $(PYTEST)

lint: .venv/test.stamp  ## the static checks alone: style, docstrings, types
	@.venv/bin/ruff check .
	@.venv/bin/mypy

clean:  ## remove the environments and what the tools left behind
	@rm -rf .venv .venv-oldest .coverage .coverage.* .hypothesis .mypy_cache .pytest_cache \
	    .ruff_cache build install log *.egg-info
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Installed anew only when what is to be installed has changed.
.venv/demo.stamp: $(SOURCES)
	@tools/environment.sh .venv '3.12 3.11 3.13' plot
	@touch $@

.venv/test.stamp: $(SOURCES)
	@tools/environment.sh .venv '3.12 3.11 3.13' plot,test,check
	@touch .venv/demo.stamp $@

.venv-oldest/test.stamp: $(SOURCES) test/oldest.txt
	@tools/environment.sh .venv-oldest '3.12 3.11' plot,test --constraint test/oldest.txt
	@touch $@
