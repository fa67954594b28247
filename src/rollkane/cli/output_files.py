"""Files that a command writes: refused before it runs, or written after it."""

import contextlib
import importlib.util
import os
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NoReturn

import click

_NEEDS = {
    "out": (("xarray", "h5netcdf", "h5py"), "results"),
    "plot": (("matplotlib",), "plot"),
    "path": (("matplotlib",), "plot"),
    "view": ((), ""),
    "json": ((), ""),
    "report": (("matplotlib",), "plot"),
}


def check_targets(targets: dict[str, Path], scene: str, data: str = "") -> None:
    """Refuse, before anything runs, what could not be written after it."""
    taken = {Path(scene).resolve(): "SCENE"}
    if data:
        taken[Path(data).resolve()] = "DATA"
    for name, target in targets.items():
        option = f"--{name}"
        folder = target.resolve().parent
        if not folder.is_dir():
            _refuse(option, f"the folder {folder} does not exist; make it first")
        if target.is_dir():
            _refuse(option, f"{target} is a folder; give the name of a file")
        if not os.access(folder, os.W_OK):
            _refuse(option, f"the folder {folder} cannot be written to")
        if target.resolve() in taken:
            other = taken[target.resolve()]
            _refuse(option, f"{target} is the file of {other}; give another name")
        taken[target.resolve()] = option
        modules, extra = _NEEDS[name]
        for module in modules:
            if importlib.util.find_spec(module) is None:
                _refuse(
                    option,
                    f"needs {module}, which is not installed: "
                    f"pip install 'rollkane[{extra}]'",
                )


def _refuse(option: str, message: str) -> NoReturn:
    raise click.BadParameter(message, param_hint=f"'{option}'")


def write(name: str, result: Any, target: Path, title: str) -> bool:
    """Whether the file could be made: a run without any state shows nothing."""
    from ..validation.checks import FieldError

    try:
        with telling_of_files(f" {target}"):
            _writer(name)(result, target, title)
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


def _writer(name: str) -> Callable[[Any, Path, str], None]:
    if name == "out":
        from ..files.export import write_netcdf

        return lambda result, target, title: write_netcdf(result, target)
    if name == "view":
        from ..pictures.viewer import write_view

        return write_view
    from ..pictures.plotting import plot_contact_path, plot_overview

    return plot_overview if name == "plot" else plot_contact_path
