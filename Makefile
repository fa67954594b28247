# Each target sets up what it needs: a virtual environment in .venv, from python3 or
# what PYTHON names; another version of it makes the environment anew.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d.%d" % sys.version_info[:3])')
MADE := $(VENV)/.python-$(VERSION)
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal
# What depends on releases of Python and JAX: the call interface and the native loop,
# derivatives, ensembles, the house, the command line.
RELEASES := tests/house tests/physics/test_native_runs.py tests/physics/test_gradients.py \
	tests/physics/test_ensemble.py tests/unit/test_call_interface.py \
	tests/unit/test_native.py tests/unit/test_methods.py tests/unit/test_cache.py tests/unit/test_cli.py \
	tests/unit/test_impossible_numbers.py tests/unit/test_outer_derivatives.py \
	tests/unit/test_sampling.py tests/unit/test_store.py tests/unit/test_by_index.py \
	tests/unit/test_small_matrices.py

.PHONY: demo test test-all test-releases test-browser test-gpu lint format bench bench-engine bench-peers bench-fit bench-rolling bench-sensitivity bench-monte-carlo bench-live bench-gpu accuracy growth compiling stability docs clean

demo: $(VENV)/.installed
	@mkdir -p out
	$(BIN)/rollkane simulate rattleback --force --out out/rattleback.nc --plot out/rattleback.png \
		--path out/rattleback_path.png --view out/rattleback.html

test: $(VENV)/.installed
	$(PYTEST) -m "not slow"

# these two with a compiler's full effort, as users have it
test-all: $(VENV)/.docs
	ROLLKANE_CFLAGS= $(PYTEST)

test-releases: $(VENV)/.installed
	ROLLKANE_CFLAGS= $(PYTEST) -m "not slow" $(RELEASES)

# pages as a headless Chromium shows them (CHROMIUM=command names another one); skipped
# where there is none: apt-get install chromium
test-browser: $(VENV)/.installed
	$(PYTEST) tests/browser

# on the GPU at hand, with JAX for it (pip install "jax[cuda13]"); skipped where there is none
test-gpu: $(VENV)/.installed
	$(BIN)/python -m pytest tests/gpu

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.bench
	$(BIN)/python benchmarks/single.py --out benchmarks/results
	$(BIN)/python benchmarks/effects.py --out benchmarks/results
	$(BIN)/python benchmarks/laws.py --out benchmarks/results
	$(BIN)/python benchmarks/isolator.py --out benchmarks/results
	$(BIN)/python benchmarks/kane.py --out benchmarks/results
	$(BIN)/python benchmarks/contact_changes.py --out benchmarks/results
	$(BIN)/python benchmarks/steady.py --out benchmarks/results
	$(BIN)/python benchmarks/events.py --out benchmarks/results

bench-engine: $(VENV)/.bench
	$(BIN)/python benchmarks/engine.py --out benchmarks/results

bench-peers: $(VENV)/.bench .venv-mujoco/.installed .venv-exudyn/.installed
	$(BIN)/python benchmarks/compare.py --out benchmarks/results

bench-fit: $(VENV)/.bench .venv-sysid/.installed
	$(BIN)/python benchmarks/fit.py --seeds 100 --out benchmarks/results

.venv-sysid/.installed:
	-$(PYTHON) -m venv .venv-sysid && .venv-sysid/bin/python -m pip install --quiet \
		--disable-pip-version-check 'mujoco[sysid]' && touch $@

bench-rolling: $(VENV)/.bench
	$(BIN)/python benchmarks/rolling_bodies.py --out benchmarks/results
	$(BIN)/python benchmarks/ball_on_plate.py --out benchmarks/results

bench-sensitivity: $(VENV)/.bench .venv-salib/.installed
	$(BIN)/python benchmarks/sobol_indices.py --out benchmarks/results --docs docs
	$(BIN)/python benchmarks/rare_events.py --out benchmarks/results --docs docs

# a peer that cannot be installed is skipped by name
.venv-%/.installed:
	-$(PYTHON) -m venv .venv-$* && .venv-$*/bin/python -m pip install --quiet \
		--disable-pip-version-check numpy $* && touch $@

bench-monte-carlo: $(VENV)/.bench
	$(BIN)/python benchmarks/monte_carlo.py --out benchmarks/results
	$(BIN)/python benchmarks/convergence.py --out benchmarks/results
	$(BIN)/python benchmarks/faults.py --out benchmarks/results

bench-live: $(VENV)/.bench
	$(BIN)/python benchmarks/live.py --out benchmarks/results

bench-gpu: $(VENV)/.bench
	$(BIN)/python benchmarks/gpu.py --out benchmarks/results

accuracy: $(VENV)/.bench
	$(BIN)/python benchmarks/accuracy.py --out benchmarks/results

growth: $(VENV)/.bench
	$(BIN)/python benchmarks/growth.py --out benchmarks/results

compiling: $(VENV)/.bench
	$(BIN)/python benchmarks/compiling.py --out benchmarks/results

stability: $(VENV)/.bench
	$(BIN)/python benchmarks/stability.py --out benchmarks/results
	$(BIN)/python benchmarks/scales.py --out benchmarks/results

docs: $(VENV)/.docs build/gallery/.made
	$(BIN)/python -m sphinx --fail-on-warning --keep-going -q -d build/doctrees \
		-D nb_execution_cache_path=$(CURDIR)/build/notebooks docs site
	$(BIN)/python docs/check_site.py site
	$(BIN)/python -m tests.browser.page_heights site

# what scenes, viewer or loop look like may have changed with any source
build/gallery/.made: $(VENV)/.docs docs/images/gallery.py $(wildcard docs/gallery/*.toml) \
		$(shell find src/rollkane -name '*.py' -o -name '*.js' -o -name '*.toml')
	$(BIN)/python docs/images/gallery.py pages build/gallery
	@touch $@

clean:
	rm -rf $(VENV) .venv-other .venv-mujoco .venv-exudyn .venv-salib .venv-sysid out site build dist

$(MADE):
	@$(PYTHON) -c 'import sys; sys.exit("rollkane needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv --clear $(VENV)
	@touch $@

$(VENV)/.installed: $(MADE) pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	@touch $@

$(VENV)/.dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

$(VENV)/.bench: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	@touch $@

$(VENV)/.docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@
