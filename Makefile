# SPDX-License-Identifier: Apache-2.0
PYTHON ?= python3
VENV := .venv
PIP := -m pip --disable-pip-version-check install --quiet --quiet

.PHONY: setup
setup: $(VENV)/.dev

$(VENV)/.created:
	$(PYTHON) -m venv --clear $(VENV)
	touch $@

$(VENV)/.runtime: $(VENV)/.created requirements/runtime.txt setup.py setup.cfg
	$(VENV)/bin/python $(PIP) --no-deps -r requirements/runtime.txt
	$(VENV)/bin/python $(PIP) --no-deps --no-build-isolation -e .
	touch $@

$(VENV)/.ros: $(VENV)/.runtime requirements/ros-kilted.txt
	$(VENV)/bin/python $(PIP) --no-deps -r requirements/ros-kilted.txt
	touch $@

$(VENV)/.dev: $(VENV)/.ros requirements/dev.txt
	$(VENV)/bin/python $(PIP) --no-deps -r requirements/dev.txt
	touch $@
