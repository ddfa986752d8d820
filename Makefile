# The daily commands. A fresh machine needs Python 3.11 or newer, make, and a package index.
PYTHON ?= python3
BIN := .venv/bin
CORE := .venv/.core-installed
DEV := .venv/.dev-installed
SITE := .venv/.site-installed
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check
PIP_LOCKED := $(PIP_INSTALL) --no-deps --require-hashes
RUN ?=
# To rewrite assert is half of what collecting costs, in each worker: only what failed is run again to tell its values.
PLAIN := --assert=plain
AGAIN := --last-failed --last-failed-no-failures none

.PHONY: demo test slow check sync mutants bench docs site lock clean

demo: $(CORE)  ## install and run the main job: a simulated tomato is seen, grasped, shaken, measured
	$(BIN)/anther trial --plant tomato --seed 2 --out runs/demo --overwrite || [ $$? -eq 1 ]  # 1: a part of its verdict failed

test: $(DEV)  ## run the tests, four at a time: those of drivers mostly wait
	$(BIN)/anther doctor --compile  # once, not in each of the four
	$(BIN)/python -m pytest -n 4 $(PLAIN) || { $(BIN)/python -m pytest $(AGAIN); exit 1; }

slow: $(DEV)  ## run the slow tests
	$(BIN)/python -m pytest -n 2 -m slow $(PLAIN) || { $(BIN)/python -m pytest -m slow $(AGAIN); exit 1; }

check: $(DEV)  ## format, lint, types, layering
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright
	$(BIN)/python -m pytest tests/test_house.py

sync: $(DEV)  ## only the environment

mutants: $(DEV)  ## small wrong changes, and which of them the tests catch (hours)
	$(BIN)/python -m evaluation.robustness.mutants

bench: $(DEV)  ## speed
	$(BIN)/python -m evaluation.speed --quick
	for script in evaluation/speed/[a-z]*.py; do $(BIN)/python -m evaluation.speed.$$(basename $$script .py) --quick || exit 1; done

docs: $(DEV) demo  ## measure again what docs/reports shows, at one commit (90 minutes; goes on where it was stopped)
	$(BIN)/python -m evaluation.record docs/reports/*.md
	$(BIN)/python -m evaluation.numbers
	$(BIN)/python tools/film_shake.py docs/pictures/shake.webp

site: $(SITE)  ## the documentation site in build/site; its tutorials are run, every warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

lock: $(SITE)  ## renew the lock files and docs/licences.md from what is installed
	$(BIN)/python tools/lock.py

clean:
	rm -rf .venv .pytest_cache .ruff_cache build dist

$(CORE): requirements.lock pyproject.toml
	@echo "Installing Anther and its pinned dependencies into .venv (about 1.5 GB, once) ..."
	$(PYTHON) tools/make_env.py .venv
	$(PIP_LOCKED) -r requirements.lock
	$(PIP_INSTALL) --no-deps --no-build-isolation -e .
	@touch $@

$(DEV): $(CORE) requirements-dev.lock requirements-torch.lock
	$(PIP_LOCKED) -r requirements-dev.lock
	$(PIP_LOCKED) -r requirements-torch.lock || echo "Without torch, tests of networks are skipped."
	@touch $@

$(SITE): $(DEV) requirements-site.lock
	$(PIP_LOCKED) -r requirements-site.lock
	@touch $@
