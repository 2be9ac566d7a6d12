# lierb. `make help` lists the targets; all they need is Python 3.11 to 3.14 and make.
#
#   make test ARGS="-k paper -x"    arguments for pytest (ARGS works for demo and bench too)
#   make test ARGS="-n 0 --pdb"     in one process
#   make bench-peers MECHANISMS="--mechanisms chain2"   arguments for its second part, mechanisms
#   make install PYTHON=python3.13  the interpreter for the environment
#   make test VENV=../lierb-venv    where the environment is; test-oldest's is VENV-oldest

SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))
CANDIDATES := python3 python3.14 python3.13 python3.12 python3.11 python
PYTHON ?= $(shell for python in $(CANDIDATES); do \
	"$$python" -c '$(SUPPORTED)' >/dev/null 2>&1 && { echo "$$python"; break; }; done)
VENV ?= .venv
OLDEST := $(VENV)-oldest
BIN := $(VENV)/bin
# A test that does not end fails after 10 minutes, and the run with it.
TIME_LIMIT := -o faulthandler_timeout=600 -o faulthandler_exit_on_timeout=true --max-worker-restart=0
ARGS ?=
MECHANISMS ?=

.PHONY: help install demo docs check-docs picture test test-mechanisms test-long test-oldest lint dist faults bench bench-peers clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-12s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))

install: $(VENV)/.dev  ## make the environment in .venv, with everything for development

demo: $(VENV)/.demo  ## reproduce section 5 of the paper: tables and figures in results/paper
	$(BIN)/lierb paper --out results/paper $(ARGS)

docs: $(VENV)/.docs  ## build the site in docs/_build/html; its notebooks run, a warning is an error
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet docs docs/_build/html $(ARGS)
	@echo "docs/_build/html/index.html"

check-docs:  ## build the site, follow README and CONTRIBUTING, in a clone with its own environments
	rm -rf results/clone
	git clone --quiet . results/clone
	$(MAKE) -C results/clone VENV=.venv docs
	$(MAKE) -C results/clone VENV=.venv dist
	$(MAKE) -C results/clone VENV=.venv test ARGS="-m 'long or not long' tests/test_contributing.py tests/test_docs.py tests/test_site.py"

picture: $(VENV)/.docs  ## draw the picture of the front page again
	$(BIN)/python docs/gallery/heavy_top.py docs/_static/heavy_top.png

test: $(VENV)/.dev  ## run the tests, on up to four cores
	$(BIN)/python -m compileall -q lierb  # once, where PYTHONDONTWRITEBYTECODE is set
	$(BIN)/python -m pytest -n auto --maxprocesses 4 $(TIME_LIMIT) $(ARGS)

test-oldest: $(OLDEST)/.test  ## run the tests with every dependency at its lower bound
	NUMBA_CACHE_DIR=$(abspath $(OLDEST))/cache \
		$(OLDEST)/bin/python -m pytest -n auto --maxprocesses 4 $(TIME_LIMIT) $(ARGS)

lint: $(VENV)/.dev  ## ruff, mypy, the import contracts and the spelling
	$(BIN)/ruff check .
	$(BIN)/codespell
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

dist: $(VENV)/.publish  ## build sdist and wheel, check them, install the wheel where nothing is
	rm -rf dist
	$(BIN)/python -m build
	$(BIN)/python -m twine check --strict dist/*.whl dist/*.tar.gz
	"$(PYTHON)" -m venv dist/empty
	dist/empty/bin/python -m pip install --quiet --disable-pip-version-check \
		"$$(echo dist/*.whl)[study]"
	cd dist && NUMBA_CACHE_DIR=empty/cache empty/bin/python ../tests/installed.py *.whl
	rm -rf dist/empty

test-mechanisms: $(VENV)/.dev  ## all mechanisms against the oracle and published motion (10 minutes)
	$(BIN)/python -m pytest -n auto -m "long or not long" tests/mechanisms

test-long: $(VENV)/.dev  ## what other tests try one of each kind, all of it: forms, methods, joints
	$(BIN)/python -m pytest -n auto --maxprocesses 4 -m long $(ARGS)

faults: $(VENV)/.dev  ## break what can be broken, and count (docs/faults.md; most of an hour)
	cd tests && $(abspath $(BIN))/python -m faults --out ../results/faults $(ARGS)

bench: $(VENV)/.dev  ## run the benchmarks, store them in bench/results, compare with the last run
	$(BIN)/python bench/track.py $(ARGS)

bench-peers: $(VENV)/.peers  ## run lierb and its peers side by side, store the tables
	cd bench && $(abspath $(BIN))/python -m peers $(ARGS)
	cd bench && $(abspath $(BIN))/python -m tolerances
	cd bench && $(abspath $(BIN))/python -m linkages $(MECHANISMS)

clean:  ## remove what make made: the environment, results, caches, builds
	rm -rf $(VENV) $(OLDEST) results build dist docs/_build .benchmarks .coverage htmlcov
	rm -rf .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	find lierb tests bench -name __pycache__ -type d -prune -exec rm -rf {} +

# Each stamp is redone when pyproject.toml changes, and only then.
$(VENV)/.demo: EXTRAS := cli,plot
$(VENV)/.dev: EXTRAS := dev
$(VENV)/.docs: EXTRAS := docs
$(VENV)/.peers: EXTRAS := dev,peers
$(VENV)/.publish: EXTRAS := publish
$(OLDEST)/.test: EXTRAS := test
$(VENV)/.demo $(VENV)/.dev $(VENV)/.docs $(VENV)/.peers $(VENV)/.publish $(OLDEST)/.test: pyproject.toml
	@"$(PYTHON)" -c '$(SUPPORTED)' 2>/dev/null || { \
		echo "lierb needs Python 3.11 to 3.14, and '$(or $(PYTHON),python3)' is not one." >&2; \
		echo "Name one that is:  make $(MAKECMDGOALS) PYTHON=/path/to/python3.12" >&2; exit 1; }
	test -x $(@D)/bin/pip || "$(PYTHON)" -m venv $(@D)
	@echo "Installing lierb [$(EXTRAS)] into $(@D), about a minute ..."
	$(INSTALL) --editable '.[$(EXTRAS)]'
	@touch $@

PIP = $(@D)/bin/python -m pip install --quiet --disable-pip-version-check
INSTALL = $(PIP)
# uv can take the oldest releases, of those that have a wheel for this Python; pip cannot.
$(OLDEST)/.test: INSTALL = $(PIP) uv && $(@D)/bin/python -m uv pip install --quiet --python $(@D) \
	--upgrade --resolution lowest-direct --only-binary :all: --no-binary lierb
