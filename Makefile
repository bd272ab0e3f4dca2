# SPDX-License-Identifier: Apache-2.0
# `make` or `make help` lists the targets. Each brings the environments it uses up to date first.

# CPython 3.10 to 3.13. Where it is given, environments of another one are made again.
PYTHON ?= python3
INSTALL := $(PYTHON) requirements/install.py $(if $(filter file,$(origin PYTHON)),,--exact)
RUN := .venv/bin/python
PYTEST := $(RUN) -m pytest

# The tests' matrices are small: threads of BLAS only wait for each other, twice the time.
test unit suites kernels jazzy colcon: export OPENBLAS_NUM_THREADS := 1

# An environment finds the libraries of its own ROS, not of one that make was called from.
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
endif

.NOTPARALLEL:
.PHONY: help runtime setup demo test lint format unit suites unit-suites oldest-suites node-suites kernels jazzy \
        environments jazzy-environment colcon-environment colcon clients browser fuzz soak evaluate benchmark docs \
        nodes-page site images maintainers \
        lock dist clean distclean

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' Makefile
	@echo 'PYTHON=python3.12 selects the interpreter (CPython 3.10 to 3.13).'

setup: ## .venv with ROS 2, this package and the developers' tools
	@$(INSTALL) .venv runtime ros-kilted extras test dev

runtime:
	@$(INSTALL) .venv runtime

demo: runtime ## the whole chain on the recorded bag; writes out/demo/
	@$(RUN) -m binocular_recon demo --output out/demo

# The closing line is that of the whole suite; it says what was not run. The other environments
# are installed, and the site is made, while the code is checked: each keeps one core busy.
test: ## everything that CI runs
	@$(MAKE) --no-print-directory environments & environments=$$!; \
	$(MAKE) --no-print-directory site & site=$$!; \
	$(MAKE) --no-print-directory lint; status=$$?; \
	wait $$site || status=$$?; wait $$environments && exit $$status
	@$(MAKE) --no-print-directory suites

lint: setup ## format, lint rules and types
	.venv/bin/ruff format --check
	.venv/bin/ruff check
ifdef ROS_DISTRO
	@echo 'ROS 2 $(ROS_DISTRO) is sourced: types are checked against the locked versions only'
else
	.venv/bin/mypy
endif

format: setup ## format the code and mend what the linter can
	.venv/bin/ruff format
	.venv/bin/ruff check --fix

unit: setup ## unit tests only, on all cores
	$(PYTEST) -q -n auto --dist loadfile test/unit

kernels: setup ## kernels against their naive twins, not compiled
	NUMBA_DISABLE_JIT=1 $(PYTEST) -q -m 'kernel and not large' -W ignore::RuntimeWarning test/unit

ifdef ROS_DISTRO
environments: colcon-environment

jazzy:
	@echo 'ROS 2 $(ROS_DISTRO) is sourced: no tests with the Jazzy wheels'

suites: unit kernels colcon
	$(PYTEST) --done test/unit
else
environments: jazzy-environment colcon-environment

jazzy-environment:
	@$(INSTALL) .venv-jazzy oldest ros-jazzy oldest-extras test
	@.venv-jazzy/bin/python -c 'import sys; sys.exit(sys.version_info >= (3, 13))' || \
	    echo "CPython 3.13: with the oldest versions that have wheels for it, not Ubuntu 24.04's"

jazzy: jazzy-environment ## system and unit tests with ROS 2 Jazzy and the oldest supported versions
	.venv-jazzy/bin/python -m pytest test/unit test/system

# Nodes wait most of the time: their tests run while a core is busy with the others, and what is
# left of it goes to the oldest versions.
suites: setup jazzy-environment
	@$(MAKE) --no-print-directory node-suites >.venv/nodes.log 2>&1 & nodes=$$!; \
	nice $(MAKE) --no-print-directory oldest-suites >.venv/oldest.log 2>&1 & oldest=$$!; \
	$(MAKE) --no-print-directory unit-suites; status=$$?; \
	wait $$oldest || status=$$?; cat .venv/oldest.log; \
	wait $$nodes || status=$$?; cat .venv/nodes.log; exit $$status

unit-suites:
	@echo 'tests of units and replay with the newest versions'
	$(PYTEST) -q test/unit test/replay

oldest-suites:
	@echo 'unit tests but the long ones with the oldest versions'
	.venv-jazzy/bin/python -m pytest -q test/unit -m 'not long'

node-suites:
	@echo 'system tests but the long ones with ROS 2 Jazzy, kernels that are not compiled, a ROS'
	@echo 'workspace, then all that is left with Kilted'
	.venv-jazzy/bin/python -m pytest -q test/system -m 'not long' || \
	    { status=$$?; test $$status = 5; } # 5 = there is none to run, without ROS
	@$(MAKE) --no-print-directory kernels colcon
	$(PYTEST) --done test/unit --done test/replay
endif

colcon-environment:
	@$(INSTALL) .venv-colcon colcon

colcon: setup colcon-environment ## build, install and test as a ROS workspace does
	.ci/colcon

clients: setup ## real programs open our clouds and reports: CloudCompare under Xvfb, Chromium
	@command -v CloudCompare >/dev/null && command -v xvfb-run >/dev/null || \
	    { echo 'needs CloudCompare and Xvfb: apt-get install cloudcompare xvfb xauth'; exit 1; }
	$(PYTEST) -q test/clients

browser: setup ## real clicks on the page of `view` in a headless Chromium
	@command -v chromium >/dev/null || { echo 'needs Chromium: apt-get install chromium'; exit 1; }
	$(PYTEST) -q test/browser

MINUTES ?= 10

fuzz: setup ## changed inputs of every form for MINUTES=10; findings go to out/fuzz/
	$(RUN) test/fuzz/run.py --minutes $(MINUTES) --seed $$(date +%s)

soak: setup ## the nodes under faults of every kind for MINUTES=10; report in out/soak/
	$(RUN) test/soak/run.py --minutes $(MINUTES) --output out/soak

# OpenCV's contributed modules, for comparison only, cannot be in one environment with plain OpenCV.
SCENES ?= $(or $(BINOCULAR_RECON_DATA),../shared/data)/stereo

evaluate: ## accuracy on scenes with ground truth against OpenCV's matchers; SCENES=folder
	@$(INSTALL) .venv-contrib contrib
	@.venv-contrib/bin/python -m binocular_recon evaluate $(SCENES) --output out

benchmark: ## speed of each stage against its peers, on the scenes of SCENES=folder too, if it exists
	@$(INSTALL) .venv-contrib contrib
	@.venv-contrib/bin/python -m binocular_recon benchmark $(if $(wildcard $(SCENES)),--scenes $(SCENES)) --output out

docs: nodes-page site ## docs/nodes.md from what the nodes declare, and the site in docs/_build/html

nodes-page: setup
	$(RUN) docs/make_nodes.py

site: setup
	@$(INSTALL) .venv docs
	.venv/bin/sphinx-build -q -W --keep-going -d docs/_build/doctrees docs docs/_build/html

images: setup demo ## the images of README and docs from the results of the demos
	@$(RUN) -m binocular_recon demo --survey --output out/survey
	@$(RUN) docs/make_images.py out/demo out/survey
	@if command -v chromium >/dev/null; then $(RUN) docs/make_view_image.py out/demo; \
	else echo 'docs/images/view.jpg stays as it is: it needs Chromium'; fi

maintainers: setup ## MAINTAINERS.md to package.xml and CITATION.cff
	$(RUN) tools/maintainers.py

PYTHONS ?= python3.10 python3.11 python3.12 python3.13

lock: ## resolve requirements/*.txt again, with hashes, for each of PYTHONS
	@$(INSTALL) .venv-lock lock
	@$(PYTHON) requirements/lock.py .venv-lock/bin/uv $(PYTHONS)

# A build folder that is there already would lend its old files to the wheel.
dist: setup ## source distribution and wheel in dist/
	rm -rf build dist *.egg-info
	$(RUN) -c 'from setuptools import build_meta; build_meta.build_sdist("dist")' >/dev/null
	$(RUN) -m pip wheel -qq --no-deps --no-build-isolation --wheel-dir dist dist/*.tar.gz
	rm -rf *.egg-info

clean: ## what was built or computed; environments stay
	rm -rf build dist install log out docs/_build docs/api *.egg-info .mypy_cache .pytest_cache \
	    .ruff_cache
	find . -path './.*' -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## environments too
	rm -rf .venv .venv-* .venv*.lock
