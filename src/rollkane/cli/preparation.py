"""What commands begin with: JAX's settings, the scene; and how they end."""

import math
import os
from typing import TYPE_CHECKING, Any

import click

BAD_INPUT, STOPPED_EARLY = 2, 3  # exit codes
_EXTRA_OPTIONS = "xla_backend_extra_options"
_FAST_LOOPS = f"--{_EXTRA_OPTIONS}=xla_cpu_small_while_loop_byte_threshold=65536"

if TYPE_CHECKING:  # click 8.1 has no generic class
    _NumberType = click.ParamType[float]
else:
    _NumberType = click.ParamType


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


def loaded(ctx: click.Context, scene: str) -> Any:
    """The scene file, or its errors and the end of the command."""
    from ..files.scene_files import SceneFileError, load_scene

    try:
        return load_scene(scene)
    except SceneFileError as error:
        count = len(error.problems)
        click.echo(str(error), err=True)
        click.echo(f"{count} error{'s' if count > 1 else ''} in {scene}", err=True)
        ctx.exit(BAD_INPUT)
