"""Programs for a GPU on the processor: all of their way but NVRTC and the device.

Import it before rollkane is used. XLA's programs for the CPU then call what a GPU would
be called for: the same texts, launched by the same C, through a driver that runs one
thread after the other.
"""

import atexit
import itertools
import shutil
import subprocess
import tempfile
import types
from importlib.resources import files
from pathlib import Path

from jax.interpreters import mlir

from rollkane.codegen import compiler, device_program, ffi_call, platforms, targets

_HERE = Path(__file__).parent
_MADE = Path(tempfile.mkdtemp(prefix="rollkane-emulated-"))
atexit.register(shutil.rmtree, _MADE)
_numbers = itertools.count()


def _compiled(text, architecture):
    target = _MADE / f"kernel{next(_numbers)}.so"
    _compile(text, target, "-O1")
    return bytes(str(target), "utf-8") + b"\0"


def _compile(text, target, *flags):
    command = [*compiler.compiler_command(), *flags, "-x", "c", "-", "-o", str(target)]
    done = subprocess.run([*command, "-lm"], input=text.encode(), capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[:4000]


def begin():
    """Let this process take its processor for a GPU.

    Returns:
        A list that fills with the texts that a GPU's compiler would have had.
    """
    driver = _MADE / "driver.so"
    _compile((_HERE / "driver.c").read_text(), driver)
    device_program._DRIVER = f'#define CUDA_DRIVER "{driver}"'
    device_program.image_of = _compiled
    device_program._WORTH_SORTING = 20  # so that there are both kinds
    device_program.architecture = lambda: "none"
    texts = []
    text = device_program.Kernel.text.fget
    words = files("rollkane.codegen").joinpath("device.h").read_text()

    def noted(kernel):
        texts.append(text(kernel))
        own = (_HERE / "device.h").read_text()
        return texts[-1].replace(words, own)

    device_program.Kernel.text = property(noted)
    launcher = device_program.Kernel.launcher.fget
    # XLA has streams on a GPU alone
    without: str = "frame->api->stream_get(&asked)"
    device_program.Kernel.launcher = property(
        lambda kernel: launcher(kernel).replace(without, "NULL")
    )
    platforms.jax = types.SimpleNamespace(default_backend=lambda: "gpu")
    platforms._is_cuda = lambda: True
    ffi_call.nvrtc_version = lambda: "none"
    made = targets.Target

    def on_the_processor(program, platform, image):
        return made(program, "cpu", image)

    device_program.Target = on_the_processor
    rule = mlir.lower_fun(ffi_call._called_on_gpu, multiple_results=True)
    mlir.register_lowering(ffi_call._call_p, rule, platform="cpu")
    return texts
