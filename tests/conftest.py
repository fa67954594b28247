"""Strictness for every test: double precision, no silent broadcasting or promotion."""

import ctypes
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

# Compiling is most of the tests' time: XLA's translation of fused loops two fifths of
# that, its optimization a fifth, and dividing small programs among threads a tenth.
# Those options are left out that a release does not have (they end the process).
# Results differ by roundings.
FASTER = (
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_backend_optimization_level=0",
    "--xla_cpu_parallel_codegen_split_count=1",
)


def _known(flags: str) -> bool:
    tried = [sys.executable, "-c", "import jax; jax.devices()"]
    environment = os.environ | {"XLA_FLAGS": flags}
    return not subprocess.run(tried, env=environment, capture_output=True).returncode


if "XLA_FLAGS" not in os.environ and "PYTEST_XDIST_WORKER" not in os.environ:
    together = " ".join(FASTER)
    some = together if _known(together) else " ".join(filter(_known, FASTER))
    os.environ["XLA_FLAGS"] = some

# Two fifths of the tests' time are a C compiler's, most of it optimizing; without any,
# long runs take longer than is saved. The numbers are the same, to the bit; `make
# test-releases` and `make test-all` optimize.
os.environ.setdefault("ROLLKANE_CFLAGS", "-O1")

# loops that tests compile are kept with the tests, not in the user's cache folder
os.environ.setdefault(
    "ROLLKANE_CACHE", str(Path(__file__).parents[1] / ".pytest_cache" / "rollkane")
)

# Tracing makes and drops millions of small objects; looking for cycles among them that
# often would take a tenth of the tests' time.
gc.set_threshold(200_000, 50, 100)

# Every compiled program takes about four mappings of memory, of which Linux gives a
# process 65530; beyond, no shared library can be loaded any more. And with what JAX
# keeps of it, a worker would hold 8 GB in the end: two are to fit into 16 GB, and what
# is given back sooner is compiled again.
MAPPINGS, MEMORY = 50_000, 5 * 2**30
OWN = Path("/proc/self")
TESTS = itertools.count()


def _crowded() -> bool:
    pages = int((OWN / "statm").read_text().split()[1])
    held = pages * os.sysconf("SC_PAGE_SIZE")
    return held > MEMORY or len((OWN / "maps").read_text().splitlines()) > MAPPINGS


@pytest.fixture(autouse=True)
def _room_for_programs():
    yield
    if next(TESTS) % 10 == 9 and OWN.exists() and _crowded():
        jax.clear_caches()
        gc.collect()
        # else the C library keeps what is free; not each has a way to ask
        getattr(ctypes.CDLL(None), "malloc_trim", int)(0)
