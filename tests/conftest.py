"""Strictness for every test: double precision, no silent broadcasting or promotion."""

import gc
import itertools
import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

# loops that tests compile are kept with the tests, not in the user's cache folder
os.environ.setdefault(
    "ROLLKANE_CACHE", str(Path(__file__).parents[1] / ".pytest_cache" / "rollkane")
)

# Tracing makes and drops millions of small objects; looking for cycles among them that
# often would take a tenth of the tests' time.
gc.set_threshold(200_000, 50, 100)

# Every compiled program takes about four mappings of memory, of which Linux gives a
# process 65530; beyond, no shared library can be loaded any more.
MAPS = Path("/proc/self/maps")
TESTS = itertools.count()


@pytest.fixture(autouse=True)
def _room_for_programs():
    yield
    crowded = next(TESTS) % 20 == 19 and MAPS.exists()
    if crowded and len(MAPS.read_text().splitlines()) > 40_000:
        jax.clear_caches()
