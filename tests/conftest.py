"""Strictness for every test: double precision, no silent broadcasting or promotion."""

import gc
import itertools
import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Compiling is most of the tests' time, and XLA's translation of fused loops two fifths
# of that; where a release has no such option (which ends the process), its optimization
# is a fifth. Results differ by roundings.
FASTER = "--xla_cpu_use_fusion_emitters=false", "--xla_backend_optimization_level=0"


def _known(flag: str) -> bool:
    tried = [sys.executable, "-c", "import jax; jax.devices()"]
    environment = os.environ | {"XLA_FLAGS": flag}
    return not subprocess.run(tried, env=environment, capture_output=True).returncode


if "XLA_FLAGS" not in os.environ and "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["XLA_FLAGS"] = next(filter(_known, FASTER), "")

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
    crowded = next(TESTS) % 10 == 9 and MAPS.exists()
    if crowded and len(MAPS.read_text().splitlines()) > 50_000:
        jax.clear_caches()
