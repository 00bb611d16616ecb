# make venv | demo | test | bench | papers | docs | links | lint | clean: each does its own set-up.
SHELL := /bin/bash
.SHELLFLAGS := -eo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help venv demo test bench papers docs links lint clean

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
COMPILED := $(VENV)/.compiled

# With /opt/ros/jazzy its rclpy and messages are used, otherwise the wheels from PyPI.
ROS_SETUP := $(firstword $(wildcard /opt/ros/jazzy/setup.bash))
ROS := $(if $(ROS_SETUP),source $(ROS_SETUP) &&)
EXTRAS := $(if $(ROS_SETUP),[test],[ros,test])

# One BLAS thread a process: two on busy cores made the same step ninety times slower. Discovery
# stays on this machine, and a wrong type in a message field is an error instead of a surprise.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export ROS_PYTHON_CHECK_FIELDS := 1
# Empty: modules are compiled once, not by each process, also where the shell forbids it (containers).
export PYTHONDONTWRITEBYTECODE :=
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_NO_INPUT := 1

# One more than two cores: tests over topics mostly wait.
WORKERS ?= 3
PYTEST_ARGS ?=
DEMO_OUT ?= demo_out
PAPERS_ARGS ?=
BENCHES := $(sort $(shell grep -l __main__ bench/*.py))

help:
	@echo 'make venv   .venv with everything; `tudor` is .venv/bin/tudor'
	@echo 'make demo   learn and check a model from the recordings in bags/, and detect pushes'
	@echo 'make test   all tests and style gates (PYTEST_ARGS="-k NAME", WORKERS=N)'
	@echo 'make bench  measure speed and memory'
	@echo 'make papers the experiments of two papers, into papers_out (PAPERS_ARGS="table1 --quick")'
	@echo 'make docs   guides and reference as one site, in build/docs'
	@echo 'make links  open each external link of the site'
	@echo 'make lint   style gates alone'
	@echo 'make clean  remove all that the others made'

venv: $(COMPILED)

# What the first command would compile is compiled here: a fit and a replay of parts of bags call
# it. Tests do without, as one of their workers compiles beside the others, and all use the result.
$(COMPILED): $(STAMP)
	@echo 'compiling inner loops, half a minute, once ...'
	@folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT; $(ROS) \
	$(BIN)/tudor fit bags/two_blade_train_1@0-50% --test bags/two_blade_train_1@50-100% -q \
	  --arm config/two_blade_arm.yaml --out "$$folder/model" --exit-zero && \
	$(BIN)/tudor evaluate --model "$$folder/model" bags/two_blade_pushes --collisions -q
	@touch $@

# An older pip would run setup.py develop, which puts `tudor` where colcon wants it, not into bin.
# The stamp is written last, so that an interrupted installation is taken up again. An environment
# whose interpreter has gone is made again.
$(STAMP): setup.cfg setup.py package.xml tools/find_python
	@python=$$(tools/find_python) || exit 1; $(ROS) \
	if ! $(BIN)/python -c 'import pip' >/dev/null 2>&1; then \
	  echo "environment in $(VENV), $$($$python --version) from $$python"; \
	  $$python -m venv --clear $(if $(ROS_SETUP),--system-site-packages) $(VENV); \
	fi; \
	echo 'installing from PyPI, one or two minutes ...'; \
	$(BIN)/python -m pip install --quiet --use-pep517 --editable '.$(EXTRAS)'
	@touch $@

demo: venv
	@$(ROS) $(BIN)/tudor fit bags/two_blade_train_1 bags/two_blade_train_2 --test bags/two_blade_test \
	  --arm config/two_blade_arm.yaml --out $(DEMO_OUT)/model --overwrite
	@$(ROS) $(BIN)/tudor evaluate --model $(DEMO_OUT)/model bags/two_blade_test
# At the rate of the monitor's contact level, which warns and does not act.
	@$(ROS) $(BIN)/tudor evaluate --model $(DEMO_OUT)/model bags/two_blade_pushes --collisions \
	  --false-alarms 60 --report $(DEMO_OUT)/collisions.html
	@$(ROS) $(BIN)/tudor watch --model $(DEMO_OUT)/model bags/two_blade_pushes --false-alarms 60 \
	  --picture $(DEMO_OUT)/watch.svg
	@echo "open the live view in a browser: file://$(abspath $(DEMO_OUT))/watch.svg"
	@echo "open the report in a browser: file://$(abspath $(DEMO_OUT))/model/report.html"

test: $(STAMP)
	@$(ROS) $(BIN)/python -m pytest -n $(WORKERS) --dist loadscope --no-loadscope-reorder $(PYTEST_ARGS)

bench: venv
	@$(if $(BENCHES),,echo 'no script in bench/' >&2; exit 1;) $(ROS) \
	for script in $(BENCHES); do echo "== $$script"; $(BIN)/python $$script; done

papers: venv
	@$(ROS) $(BIN)/python -m papers $(PAPERS_ARGS)

# Any warning ends it: a docstring that Sphinx cannot read is one that people cannot read.
docs: venv
	@$(BIN)/python -c 'import furo, myst_parser, numpydoc, sphinx_copybutton' 2>/dev/null \
	  || $(BIN)/python -m pip install --quiet --use-pep517 --editable '.[docs]'
	@$(ROS) $(BIN)/python -m sphinx -W --keep-going -j auto -b html docs build/docs
	@echo "open in a browser: file://$(abspath build/docs)/index.html"

# Needs a network, and the servers of others: not in CI.
links: docs
	@$(ROS) $(BIN)/python -m sphinx -q -b linkcheck docs build/links

lint: venv
	@$(ROS) $(BIN)/python -m pytest -q -m linter

clean:
	rm -rf $(VENV) $(DEMO_OUT) build docs/reference/generated install log *.egg-info .pytest_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
