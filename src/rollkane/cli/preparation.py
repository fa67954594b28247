"""What commands begin with: JAX's settings, the scene; and how they end."""

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from .option_values import refuse

FAILED, BAD_INPUT, STOPPED_EARLY = 1, 2, 3  # exit codes
_EXTRA_OPTIONS = "xla_backend_extra_options"
_FAST_LOOPS = f"--{_EXTRA_OPTIONS}=xla_cpu_small_while_loop_byte_threshold=65536"

if TYPE_CHECKING:  # click 8.1 has no generic class
    _NumberType = click.ParamType[float]
else:
    _NumberType = click.ParamType


def _names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Built-in scenes and files that a shell may complete a word to."""
    del ctx, param
    from click.shell_completion import CompletionItem

    from ..files.scene_files import builtin_scenes

    scenes = builtin_scenes().items()
    known = [CompletionItem(x, help=y) for x, y in scenes if x.startswith(incomplete)]
    return [*known, CompletionItem(incomplete, type="file")]


scene_argument = click.argument("scene", shell_complete=_names)


class Positive(_NumberType):
    """A finite number greater than zero."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number that an option gives, or click's usage error."""
        try:
            number = float(value)
        except ValueError:
            self.fail(f"{value!r} is not a number.", param, ctx)
        if not (math.isfinite(number) and number > 0):
            self.fail(f"{value} is not a positive number.", param, ctx)
        return number


def start_jax() -> None:
    """Double precision, and compiled loops; both must come before JAX's first use."""
    flags = os.environ.get("XLA_FLAGS", "")
    if _EXTRA_OPTIONS not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_FAST_LOOPS}".strip()
    import jax

    jax.config.update("jax_enable_x64", True)


def changes_of(given: tuple[str, ...]) -> dict[str, str]:
    """Values by path, of options ``PATH=VALUE``."""
    found: list[tuple[str, str]] = []
    for one in given:
        path, equals, text = one.partition("=")
        if not equals or not path.strip() or not text.strip():
            refuse("--set", f"{one!r} is not PATH=VALUE, such as body.mass=2.0")
        found.append((path.strip(), text.strip()))
    refuse_undone("--set", [path for path, _ in found])
    return dict(found)


def refuse_undone(option: str, given: Sequence[str]) -> None:
    """Refuse paths of which a later one takes the place of an earlier one.

    Raises:
        click.BadParameter: there are some.
    """
    from ..files.scene_files.changes import undone

    lost = undone(given)
    if lost is None:
        return
    if lost[0] == lost[1]:
        refuse(option, f"names {lost[0]} twice")
    refuse(option, f"{lost[1]} would undo {lost[0]}: give the whole first, or one")


def with_run(changes: tuple[str, ...], options: dict[str, Any]) -> tuple[str, ...]:
    """Options ``PATH=VALUE``, with how long a run lasts and how many outputs it has.

    Args:
        changes: As they are given.
        options: Those that replace what the file says of its run, None where they are
            left out; ``duration`` and ``outputs`` are taken out of it.

    Raises:
        click.BadParameter: one of them is given both ways.
    """
    from ..files.scene_files.changes import same_field

    paths = list(changes_of(changes))
    for name, value in options.items():
        if value is not None and any(same_field(x, ("run", name)) for x in paths):
            option = name.replace("_", "-")
            refuse("--set", f"sets run.{name}, which --{option} sets, too")
    given = {name: options.pop(name) for name in ("duration", "outputs")}
    own = (f"run.{name}={x!r}" for name, x in given.items() if x is not None)
    return (*changes, *own)


def loaded(ctx: click.Context, scene: str, changes: tuple[str, ...] = ()) -> Any:
    """The scene file, or its errors and the end of the command.

    Args:
        ctx: Of the command.
        scene: Name or path.
        changes: Options ``PATH=VALUE``, in the place of what the file gives.
    """
    from ..files.scene_files import SceneFileError, load_scene

    try:
        return load_scene(scene, changes_of(changes))
    except SceneFileError as error:
        count = len(error.problems)
        click.echo(str(error), err=True)
        click.echo(f"{count} error{'s' if count > 1 else ''} in {scene}", err=True)
        ctx.exit(BAD_INPUT)
