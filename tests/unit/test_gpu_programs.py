"""Programs for a GPU where there is none: run by a processor, and compiled by NVRTC."""

import pickle
import subprocess
import sys

import pytest

from rollkane.codegen import NoCompilerError
from rollkane.codegen.nvrtc import compiled, nvrtc_version

from .. import gpu_runs

# in a process of its own, which takes its processor for a GPU
_EMULATED = """
import pickle, sys
import tests.conftest
from tests.emulated_gpu import emulation
texts = emulation.begin()
from tests import gpu_runs
found = getattr(gpu_runs, sys.argv[2])()
with open(sys.argv[1], "wb") as file:
    pickle.dump((found, texts), file)
"""


def emulated(path, what):
    command = [sys.executable, "-W", "error", "-c", _EMULATED, str(path), what]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with open(path, "rb") as file:
        return pickle.load(file)


@pytest.fixture(scope="module")
def some_emulated(tmp_path_factory):
    return emulated(tmp_path_factory.mktemp("emulated") / "found.pkl", "some")


@pytest.fixture(scope="module")
def all_emulated(tmp_path_factory):
    return emulated(tmp_path_factory.mktemp("emulated") / "found.pkl", "everything")


def test_as_on_the_processor(some_emulated):
    found, texts = some_emulated
    here = gpu_runs.some()
    gpu_runs.check(here, found, exact=here)
    # two runs alone and in batches, a recorded one, its changes, and its cotangents
    # alone and in batches
    assert len(set(texts)) >= 8


def test_a_kernel_is_compiled(some_emulated):
    _skip_without_nvrtc()
    _, texts = some_emulated
    shortest = min((text for text in texts if "queue_of" in text), key=len)
    assert compiled(shortest, "sm_90")[0].startswith(b"\x7fELF")


@pytest.mark.slow
def test_all_as_on_the_processor(all_emulated):
    found, _ = all_emulated
    here = gpu_runs.everything()
    gpu_runs.check(here, found, exact=here)


@pytest.mark.slow
def test_all_kernels_are_compiled(all_emulated):
    _skip_without_nvrtc()
    _, texts = all_emulated
    for text in set(texts):
        image, log = compiled(text, "sm_90", "--ptxas-options=-v")
        assert image.startswith(b"\x7fELF")
        assert "registers" in log


def test_what_the_compiler_says_is_told():
    _skip_without_nvrtc()
    with pytest.raises(NoCompilerError, match=r"NVRTC.*error: .*KERNEL"):
        compiled("int x = KERNEL;", "sm_90")


def _skip_without_nvrtc():
    try:
        nvrtc_version()
    except NoCompilerError:
        pytest.skip("NVRTC is not installed")
