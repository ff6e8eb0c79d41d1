# Two commands: `make fly` flies the animals, `make test` tests. Both set themselves up in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# 20 of the mission's 30 au: a fresh machine's first flight has landed within three minutes.
FLY ?= --mission missions/animals.yaml --horizon-au 20
# Bytecode is written when a module is first imported: for all of torch at once it takes half a minute.
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt
export PYTHONDONTWRITEBYTECODE :=

.PHONY: fly test test-slow lint types clean

fly: $(VENV)/.installed
	$(BIN)/dronemon fly $(FLY)

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n auto --dist worksteal

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m lengthy -n auto --dist worksteal
	$(BIN)/python -m pytest -m slow

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check . && $(BIN)/ruff format --check .

types: $(VENV)/.installed-dev
	$(BIN)/mypy

$(VENV)/.installed: pyproject.toml constraints.txt
	@echo "setting up $(VENV): the packages in pyproject.toml (about a minute the first time)"
	test -x $(BIN)/python || $(PYTHON) -m venv --upgrade-deps $(VENV)
	$(INSTALL) -e .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	@echo "adding what tests, lint and types need"
	$(INSTALL) -e '.[test,dev]'
	@touch $@

clean:
	rm -rf $(VENV) build dist
	find dronemon sim tests benchmarks -name __pycache__ -prune -exec rm -rf {} +
