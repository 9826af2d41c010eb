# `make train` and `make test` need Python 3.10 or newer and nothing else: they create .venv, install
# the package into it and run. They install again only after pyproject.toml or constraints.txt changed.
#
#   make train ARGS="seed=1"      arguments go to the recipe (to pytest in `make test`)
#   make train PIP_ARGS="..."     arguments go to pip install, for instance an index of your own

PYTHON      ?= $(shell command -v python3.11 || command -v python3)
VENV        ?= .venv
CONSTRAINTS ?= constraints.txt
WORKERS     ?= 2
ARGS        ?=
PIP_ARGS    ?=

BIN     := $(VENV)/bin
INSTALL  = $(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) -c $(CONSTRAINTS)

.PHONY: help train drive metadrive test lint bench constraints clean

help:
	@echo "make train        install into $(VENV) and train: python recipes/haim.py ARGS"
	@echo "make drive        the same on one easy map, with you as the mentor, in a browser"
	@echo "make metadrive    train on MetaDrive, the paper's simulator"
	@echo "make test         ruff, mypy and all tests: pytest ARGS"
	@echo "make lint         ruff and mypy only"
	@echo "make bench        speed and memory: benchmarks/bench_*.py"
	@echo "make constraints  write constraints.txt anew, from the newest versions that pip finds"
	@echo "make clean        remove $(VENV) and the tools' caches"

train: $(VENV)/installed
	$(BIN)/python recipes/haim.py $(ARGS)

drive: $(VENV)/installed-browser
	$(BIN)/python recipes/haim.py preset=first_drive mentor=browser $(ARGS)

metadrive: $(VENV)/installed-metadrive
	$(BIN)/python recipes/haim.py env=metadrive $(ARGS)

test: lint
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) $(ARGS)

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/installed-bench
	@set -e; for file in benchmarks/bench_*.py; do \
		echo "== $$file"; OMP_NUM_THREADS=1 $(BIN)/python $$file $(ARGS); \
	done

$(BIN)/python:
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
		{ echo "Python 3.10 or newer is needed; name one with make PYTHON=..."; exit 1; }
	"$(PYTHON)" -m venv $(VENV)

$(VENV)/installed: pyproject.toml constraints.txt | $(BIN)/python
	$(INSTALL) -e .
	@touch $@

# MetaDrive asks for pygame, which overwrites the files of pygame-ce; it runs with either.
$(VENV)/installed-dev: pyproject.toml constraints.txt | $(BIN)/python
	$(INSTALL) -e ".[dev]"
	$(BIN)/python -m pip uninstall --quiet --yes pygame
	$(INSTALL) --force-reinstall --no-deps pygame-ce
	@touch $@ $(VENV)/installed

$(VENV)/installed-metadrive: pyproject.toml constraints.txt | $(BIN)/python
	$(INSTALL) -e ".[metadrive]"
	$(BIN)/python -m pip uninstall --quiet --yes pygame
	$(INSTALL) --force-reinstall --no-deps pygame-ce
	@touch $@ $(VENV)/installed

$(VENV)/installed-browser: pyproject.toml constraints.txt | $(BIN)/python
	$(INSTALL) -e ".[browser]"
	@touch $@ $(VENV)/installed

$(VENV)/installed-bench: pyproject.toml constraints.txt | $(BIN)/python
	$(INSTALL) -e ".[bench]"
	@touch $@ $(VENV)/installed

# The pins carry no local version label, so that pip takes the build of torch that it is offered, and
# hold for Python 3.11 and newer, since several packages have dropped Python 3.10.
constraints:
	rm -rf $(VENV)-fresh && "$(PYTHON)" -m venv $(VENV)-fresh
	$(VENV)-fresh/bin/python -m pip install --quiet $(PIP_ARGS) -e ".[dev]"
	{ sed '/^[^#]/d' constraints.txt; \
	  $(VENV)-fresh/bin/python -m pip freeze --exclude-editable \
	  | sed -E 's/\+[a-z0-9.]+$$//; s/$$/ ; python_version >= "3.11"/'; } > constraints.new
	mv constraints.new constraints.txt
	rm -rf $(VENV)-fresh

clean:
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .hypothesis
