# Each target sets up what it needs: a virtual environment in .venv, from python3.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test test-all lint format bench bench-peers accuracy growth compiling stability docs clean

demo: .venv/.installed
	@mkdir -p out
	$(BIN)/rollkane simulate rattleback --out out/rattleback.nc --plot out/rattleback.png \
		--path out/rattleback_path.png --view out/rattleback.html

test: .venv/.installed
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

test-all: .venv/.installed
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: .venv/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: .venv/.bench
	$(BIN)/python benchmarks/single.py --out benchmarks/results
	$(BIN)/python benchmarks/effects.py --out benchmarks/results
	$(BIN)/python benchmarks/laws.py --out benchmarks/results
	$(BIN)/python benchmarks/isolator.py --out benchmarks/results
	$(BIN)/python benchmarks/kane.py --out benchmarks/results

bench-peers: .venv/.bench .venv-mujoco/.installed .venv-exudyn/.installed
	$(BIN)/python benchmarks/compare.py --out benchmarks/results

# a peer that cannot be installed is skipped by name
.venv-%/.installed:
	-$(PYTHON) -m venv .venv-$* && .venv-$*/bin/python -m pip install --quiet \
		--disable-pip-version-check numpy $* && touch $@

accuracy: .venv/.bench
	$(BIN)/python benchmarks/accuracy.py --out benchmarks/results

growth: .venv/.bench
	$(BIN)/python benchmarks/growth.py --out benchmarks/results

compiling: .venv/.bench
	$(BIN)/python benchmarks/compiling.py --out benchmarks/results

stability: .venv/.bench
	$(BIN)/python benchmarks/stability.py --out benchmarks/results

docs: .venv/.docs
	$(BIN)/mkdocs build --strict

clean:
	rm -rf .venv .venv-mujoco .venv-exudyn out site build dist

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.exit("rollkane needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv .venv

.venv/.installed: .venv/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	@touch $@

.venv/.dev: .venv/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

.venv/.bench: .venv/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	@touch $@

.venv/.docs: .venv/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@
