"""Files that a command writes: refused before it runs, or written after it."""

import contextlib
import importlib.util
import os
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import click

from ..files.file_endings import (
    ANIMATIONS,
    JSON,
    MODELS,
    NETCDF,
    PAGES,
    PICTURES,
    TABLES,
    VIDEOS,
    ending,
    wrong_ending,
)
from .option_values import refuse

# by option: endings that it can write, the modules for it, the extra with them
_NEEDS = {
    "out": (NETCDF + TABLES, ("xarray", "h5netcdf", "h5py"), "results"),
    "plot": (PICTURES, ("matplotlib",), "plot"),
    "path": (PICTURES, ("matplotlib",), "plot"),
    "view": (PAGES, (), ""),
    "gif": (ANIMATIONS, ("PIL",), "film"),
    "mp4": (VIDEOS, ("PIL", "imageio_ffmpeg"), "film"),
    "glb": (MODELS, (), ""),
    "json": (JSON, (), ""),
    "report": (PAGES, ("matplotlib",), "plot"),
}
force_option = click.option("--force", is_flag=True, help="Replace files that exist.")


def check_targets(
    targets: dict[str, Path], scene: str, data: str = "", *, force: bool = False
) -> None:
    """Refuse, before anything runs, what could not be written after it.

    Args:
        targets: Files by option.
        scene: The argument SCENE; not to be written over.
        data: The argument DATA, likewise.
        force: Whether files that exist are replaced unasked; else the user is asked on
            a terminal, and elsewhere they are refused.
    """
    taken = {Path(scene).resolve(): "SCENE"}
    if data:
        taken[Path(data).resolve()] = "DATA"
    for name, target in targets.items():
        option = f"--{name}"
        _check_place(option, target)
        if target.resolve() in taken:
            other = taken[target.resolve()]
            refuse(option, f"{target} is the file of {other}; give another name")
        taken[target.resolve()] = option
        endings, modules, extra = _NEEDS[name]
        wrong = wrong_ending(target, endings)
        if wrong is not None:
            refuse(option, f"{target}: {wrong[0]}; {wrong[1]}")
        if ending(target) in TABLES:  # which need none of them
            modules = ()
        for module in modules:
            if importlib.util.find_spec(module) is None:
                refuse(
                    option,
                    f"needs {module}, which is not installed: "
                    f"pip install 'rollkane[{extra}]'",
                )
    for name, target in targets.items() if not force else ():
        if target.exists() and not (_is_asked() and _may_replace(target)):
            problem = f"{target} is there; give --force to replace it, or another name"
            refuse(f"--{name}", problem)


def _check_place(option: str, target: Path) -> None:
    """Refuse a file in no folder, or that is one."""
    folder = target.resolve().parent
    if not folder.is_dir():
        refuse(option, f"the folder {folder} does not exist; make it first")
    if target.is_dir():
        refuse(option, f"{target} is a folder; give the name of a file")
    if not os.access(folder, os.W_OK):
        refuse(option, f"the folder {folder} cannot be written to")


def _is_asked() -> bool:
    """Whether there is somebody to answer a question."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _may_replace(target: Path) -> bool:
    return click.confirm(f"{target} is there; replace it?", err=True)


def write(name: str, result: Any, target: Path, title: str) -> bool:
    """Whether the file could be made: a run without any state shows nothing."""
    from ..validation.checks import FieldError

    try:
        with telling_of_files(f" {target}"):
            _writer(name, target)(result, target, title)
    except FieldError as error:
        click.echo(f"error: did not write {target}: {error}", err=True)
        return False
    return True


@contextlib.contextmanager
def telling_of_files(target: str = "") -> Generator[None, None, None]:
    """A sentence, not a traceback, where the system refuses to write."""
    try:
        yield
    except OSError as error:
        raise click.ClickException(f"cannot write{target}: {error}") from error


def _writer(name: str, target: Path) -> Callable[[Any, Path, str], None]:
    if name == "out" and ending(target) in TABLES:
        from ..files.csv_table import write_csv

        return lambda result, target, title: write_csv(result, target)
    if name == "out":
        from ..files.export import write_netcdf

        return lambda result, target, title: write_netcdf(result, target)
    if name == "view":
        from ..pictures.viewer import write_view

        return write_view
    if name in ("gif", "mp4"):
        from ..pictures.film import write_film

        return write_film
    if name == "glb":
        from ..pictures.gltf import write_glb

        return write_glb
    from ..pictures.plotting import plot_contact_path, plot_overview

    return plot_overview if name == "plot" else plot_contact_path
