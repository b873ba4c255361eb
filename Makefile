# Everything runs in .venv, which is made here from any Python >= 3.11; only make and pip must be installed. A stamp
# file in .venv records each finished installation, so that the second call starts at once.

PYTHON ?= python3
EXTRA ?=
PYTEST_ARGS ?=
BENCH_ARGS ?=
ENDURANCE_ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
REQUIREMENTS := pyproject.toml constraints.txt
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
IS_NEW_ENOUGH := -c 'import sys; sys.exit(sys.version_info < (3, 11))'

.PHONY: help demo test test-all test-exhaustive lint docs bench package coverage fuzz soak kill audit clean
.NOTPARALLEL:

help:
	@echo 'make demo    install the core, then run examples/demo.py: a table on the screen, pictures in runs/demo/'
	@echo 'make test    install the core and the test tools, then run ruff, pyright and the quick tests (some ten minutes)'
	@echo 'make test-all    the same with the slow tests, and those of a browser and of PyTorch'
	@echo 'make test-exhaustive    the tests that take minutes each: thousands of runs, kilometres of ways'
	@echo 'make lint    the same installation, ruff and pyright only'
	@echo 'make docs    install the site generator, then build the documentation into site/; broken links are rejected'
	@echo 'make bench   the same installation, then foveate bench, beside benchmarks/baseline.json'
	@echo 'make package the same installation, then wheel and sdist into dist/'
	@echo 'make coverage  every test in a random order, with the line coverage of each file'
	@echo 'make fuzz    200,000 hostile inputs; make kill: 60 trainings killed; make soak: an hour of a robot, in its own time'
	@echo 'make audit   look up the pinned dependencies in lists of known vulnerabilities'
	@echo 'make clean   remove .venv and all caches; runs/ stays'
	@echo
	@echo 'PYTHON=python3.12        the Python that .venv is made from (3.11 or newer)'
	@echo 'EXTRA=ppo                for make test-all: install this extra of pyproject.toml too'
	@echo 'PYTEST_ARGS="-k arrays"  for make test and test-all: further arguments of pytest'
	@echo 'BENCH_ARGS=--quick       for make bench: its options'
	@echo 'ENDURANCE_ARGS=--help    for make fuzz, kill, soak: their options'

demo: $(VENV)/.stamp-core
	@echo '== demo: examples/demo.py'
	@$(BIN)/python examples/demo.py

test: lint
	@echo '== quick tests: pytest, two at a time'
	@$(BIN)/python -m pytest -n 2 -m 'not (slow or browser or torch)' $(PYTEST_ARGS)

test-all: $(if $(EXTRA),$(VENV)/.stamp-extra-$(EXTRA)) lint
	@echo '== all tests: pytest, two at a time'
	@$(BIN)/python -m pytest -n 2 -m 'not exhaustive' $(COUNTED) $(PYTEST_ARGS)

test-exhaustive: $(VENV)/.stamp-extra-ppo
	@echo '== exhaustive tests: pytest, two at a time'
	@$(BIN)/python -m pytest -n 2 -m exhaustive $(PYTEST_ARGS)

lint: $(VENV)/.stamp-dev
	@echo '== style: ruff check'
	@$(BIN)/ruff check
	@echo '== format: ruff format --check'
	@$(BIN)/ruff format --check
	@echo '== types: pyright'
	@$(BIN)/pyright

docs: $(VENV)/.stamp-extra-docs
	@echo '== docs: docs/generator/build.py'
	@$(BIN)/python docs/generator/build.py

bench: $(VENV)/.stamp-dev
	@$(BIN)/foveate bench --baseline benchmarks/baseline.json $(BENCH_ARGS)

package: $(VENV)/.stamp-dev
	@echo '== package: dist/'
	@$(BIN)/python -m hatchling build

# In a new random order every time; the printed seed repeats it (PYTEST_ARGS="--shuffle SEED").
coverage: COUNTED := --shuffle $(shell od -An -N2 -tu2 /dev/urandom) --cov --cov-report=json --cov-report=term:skip-covered
coverage: test-all
	@$(BIN)/python .ci/coverage.py

fuzz: $(VENV)/.stamp-dev
	@PYTHONPATH=tests $(BIN)/python -W ignore -m endurance.fuzz $(ENDURANCE_ARGS)

soak: $(VENV)/.stamp-dev
	@PYTHONPATH=tests $(BIN)/python -m endurance.soak $(ENDURANCE_ARGS)

kill: $(VENV)/.stamp-dev
	@PYTHONPATH=tests $(BIN)/python -m endurance.kill $(ENDURANCE_ARGS)

# In its own environment, so that the audit does not check its own dependencies.
audit: $(VENV)/.stamp-audit
	@$(BIN)/python .ci/audit.py $(VENV)/audit/bin/pip-audit

$(VENV)/.stamp-audit: | $(VENV)/.stamp-venv
	@echo '== install: pip-audit'
	@$(BIN)/python -m venv --without-pip $(VENV)/audit
	@$(BIN)/python -m pip --python $(VENV)/audit/bin/python install --quiet --disable-pip-version-check pip-audit==2.10.1
	@touch $@

clean:
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis .coverage* coverage.json dist site
	find . -name .git -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

# A working .venv is kept. If the system's Python has no ensurepip (Debian without python3-venv), its own pip fills the
# environment instead.
$(VENV)/.stamp-venv:
	@command -v $(PYTHON) > /dev/null || { echo 'foveate needs Python 3.11 or newer, and $(PYTHON) was not found;' \
		'name another: make PYTHON=python3.12'; exit 1; }
	@$(PYTHON) $(IS_NEW_ENOUGH) || { echo "foveate needs Python 3.11 or newer, and $(PYTHON) is" \
		"$$($(PYTHON) --version 2>&1); name another: make PYTHON=python3.12"; exit 1; }
	@if $(BIN)/python $(IS_NEW_ENOUGH) 2> /dev/null && $(BIN)/python -m pip --version > /dev/null 2>&1; then \
		echo '== environment: $(VENV) found'; \
	else \
		echo "== environment: making $(VENV) with $$($(PYTHON) --version)"; \
		$(PYTHON) -m venv --clear $(VENV) > /dev/null 2>&1 || { \
			$(PYTHON) -m venv --clear --without-pip $(VENV) && \
			$(PYTHON) -m pip --python $(BIN)/python install --quiet pip; }; \
	fi
	@touch $@

$(VENV)/.stamp-core: $(REQUIREMENTS) | $(VENV)/.stamp-venv
	@echo '== install: foveate (about 600 MB, some minutes the first time)'
	@$(INSTALL) --editable .
	@touch $@

$(VENV)/.stamp-dev: $(REQUIREMENTS) | $(VENV)/.stamp-venv
	@echo '== install: foveate and its test tools (about 900 MB, some minutes the first time)'
	@$(INSTALL) --editable '.[dev]'
	@touch $@ $(VENV)/.stamp-core

# Torch first and alone: pip then resolves its large wheels before the packages that need them.
$(VENV)/.stamp-torch: $(REQUIREMENTS) | $(VENV)/.stamp-venv
	@echo "== install: $$(grep '^torch==' constraints.txt) (large)"
	@$(INSTALL) "$$(grep '^torch==' constraints.txt)"
	@touch $@

$(VENV)/.stamp-extra-ppo: $(VENV)/.stamp-torch

$(VENV)/.stamp-extra-%: $(REQUIREMENTS) | $(VENV)/.stamp-dev
	@echo '== install: the extra $*'
	@$(INSTALL) --editable '.[$*]'
	@touch $@
