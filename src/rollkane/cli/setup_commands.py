"""Commands to begin with: a scene file of one's own, and what is installed here."""

import importlib.metadata
import importlib.util
import json
import platform as machine
from pathlib import Path
from typing import Any, cast

import click

from .output_files import telling_of_files
from .preparation import BAD_INPUT, start_jax

_PACKAGES = ("jax", "jaxlib", "diffrax", "equinox", "numpy")
_EXTRAS = {
    "plot": ("matplotlib",),
    "film": ("PIL", "imageio_ffmpeg"),
    "results": ("xarray", "h5netcdf", "h5py"),
    "study": ("zarr", "scipy", "rich", "cloudpickle"),
    "cluster": ("distributed",),
    "inference": ("numpyro",),
    "cuda": ("jax_cuda13_plugin",),
}


@click.command()
@click.argument("name")
@click.option(
    "--like", default="rattleback", show_default=True, help="Built-in scene to copy."
)
@click.pass_context
def new(ctx: click.Context, name: str, like: str) -> None:
    """Write NAME.toml, a commented scene of your own to change.

    Exit code 0: written; 2: there is such a file, or no such scene.
    """
    from ..files.atomic_file import write_whole
    from ..files.scene_files import SceneFileError, scene_text

    target = Path(name if name.endswith(".toml") else f"{name}.toml")
    if target.exists():
        click.echo(f"error: {target} is there; give another name", err=True)
        ctx.exit(BAD_INPUT)
    try:
        text = scene_text(like)
    except SceneFileError as error:
        click.echo(str(error), err=True)
        ctx.exit(BAD_INPUT)
    with telling_of_files(f" {target}"):
        write_whole(target, text.encode())
    click.echo(f"wrote {target}: rollkane check {target}; rollkane simulate {target}")


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def doctor(as_json: bool) -> None:
    """Say what is installed here, and which loop runs will take."""
    found = _found()
    if as_json:
        click.echo(json.dumps(found, indent=2))
        return
    for name, value in found.items():
        if isinstance(value, dict):
            parts = cast("dict[str, str]", value)
            for part, what in parts.items():
                click.echo(f"{name + ' ' + part:<20}{what}")
        else:
            click.echo(f"{name:<20}{value}")


def _found() -> dict[str, Any]:
    start_jax()
    import jax

    from ..codegen.cache import cache_folder
    from ..codegen.compiler import NoCompilerError, compiler_command

    try:
        compiler = " ".join(compiler_command())
        loop = "native: the loop in C"
    except NoCompilerError as error:
        compiler = f"none: {error}"
        loop = "diffrax: XLA's programs; pip install 'rollkane[compiler]'"
    try:
        cache = str(cache_folder())
    except OSError as error:
        cache = f"none that can be trusted: {error}"
    devices = cast("list[Any]", jax.devices())
    device = devices[0]
    if device.platform != "cpu" and loop.startswith("native"):
        loop = _loop_on(device)
    extras = {
        name: "installed" if _has(modules) else f"pip install 'rollkane[{name}]'"
        for name, modules in _EXTRAS.items()
    }
    return {
        "rollkane": importlib.metadata.version("rollkane"),
        "python": f"{machine.python_version()}, {machine.machine()}",
        "package": {name: importlib.metadata.version(name) for name in _PACKAGES},
        "device": f"{device.platform}, {jax.device_count()} of them",
        "precision": "double (the command line sets it; in Python, jax_enable_x64)",
        "compiler": compiler,
        "runs": loop,
        "cache": cache,
        "extra": extras,
    }


def _loop_on(device: Any) -> str:
    """Which loop takes runs on a device that is no processor."""
    from ..codegen import NoCompilerError, platform
    from ..codegen.nvrtc import nvrtc_version

    if platform() != "cuda":
        return f"diffrax: numbers are on a {device.platform}"
    try:
        return f"native: one kernel on {device.device_kind}, by NVRTC {nvrtc_version()}"
    except NoCompilerError as error:
        return f"diffrax: {error}"


def _has(modules: tuple[str, ...]) -> bool:
    return all(importlib.util.find_spec(name) is not None for name in modules)
