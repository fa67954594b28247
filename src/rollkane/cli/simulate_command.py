"""The command that runs a scene, tells what it did and writes what is asked for.

Everything heavy is imported inside the functions, as in the other commands.
"""

import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click

from ..files.scene_file_limits import MOST_OUTPUTS
from .event_options import ended, event_lines, watched
from .json_text import json_text
from .option_values import quiet_option, verbose_option
from .output_files import check_targets, force_option, write
from .preparation import (
    FAILED,
    STOPPED_EARLY,
    Positive,
    loaded,
    scene_argument,
    start_jax,
    with_run,
)
from .waiting import INTERRUPTED, waited

# a run that took this long is not repeated to tell compiling from running [s]
_SHORT = 3.0
# files that it writes, by their options
_WRITTEN = "out", "plot", "path", "view", "gif", "mp4", "glb"
# that --json has of the start and the end of what was reached
_TOLD = (
    *("position", "velocity", "orientation", "angular_velocity"),
    *("contact_on_base", "contact_on_body", "normal_force", "energy"),
)


class _Timing(NamedTuple):
    """How long a run took.

    Attributes:
        compiling: [s]; NaN where it is not known apart.
        running: [s]; with compiling, where that is not known apart.
    """

    compiling: float
    running: float

    def __str__(self) -> str:
        if math.isnan(self.compiling):
            return f"{self.running:.2f} s to compile and run"
        return (
            f"{self.compiling:.2f} s to trace and compile, {self.running:.4f} s to run"
        )


set_option = click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="PATH=VALUE",
    help="A number in the place of the file's: body.mass=2, start.orientation=[...].",
)


def run_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options that replace what the file says of its run."""
    options = (
        click.option("--rtol", type=Positive(), help="Relative tolerance of a step."),
        click.option("--atol", type=Positive(), help="Absolute tolerance of a step."),
        click.option("--duration", type=Positive(), help="Time that it lasts [s]."),
        click.option(
            "--outputs",
            type=click.IntRange(2, MOST_OUTPUTS),
            help="Number of output times.",
        ),
        click.option(
            "--max-steps",
            type=click.IntRange(min=1),
            default=10_000_000,
            show_default=True,
            help="Most steps taken.",
        ),
        click.option(
            "--method",
            type=click.Choice(["auto", "native", "diffrax"]),
            help="The loop in C, diffrax's, or the former where it can.",
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


@click.command()
@scene_argument
@click.option("--out", type=click.Path(), help="Table of the motion: .nc, .csv.")
@click.option("--plot", type=click.Path(), help="Picture: spin, tilt, energy, force.")
@click.option("--path", type=click.Path(), help="Picture: path of the contact point.")
@click.option("--view", type=click.Path(), help="HTML page that shows the motion.")
@click.option("--gif", type=click.Path(), help="Film: animated picture.")
@click.option("--mp4", type=click.Path(), help="Film: video, H.264.")
@click.option("--glb", type=click.Path(), help="Moving model: binary glTF 2.0.")
@set_option
@run_options
@click.option(
    "--stop",
    multiple=True,
    help='End the run at an event: "lift-off", or one of SCENE by its name.',
)
@force_option
@click.option("--json", "as_json", is_flag=True, help="Print what it did as JSON.")
@quiet_option
@verbose_option
@click.pass_context
def simulate(
    ctx: click.Context,
    scene: str,
    changes: tuple[str, ...],
    stop: tuple[str, ...],
    force: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """Run SCENE, a built-in scene (see `rollkane scenes`) or a TOML file.

    Exit code 0: done, or ended by an event that was to end it; 1: a file could not be
    written; 2: bad input, nothing written; 3: the motion could not be followed to its
    end, 130: Ctrl-C; what was reached is written.
    """
    asked = {name: options.pop(name) for name in _WRITTEN}
    targets = {name: Path(file) for name, file in asked.items() if file is not None}
    check_targets(targets, scene, force=force)
    start_jax()
    file = loaded(ctx, scene, with_run(changes, options))
    _refuse_untold(file, targets.get("out"))
    times = file.times
    how = how_to_run(file, **options) | watched(file, stop)
    result, timing, interrupted = _run(file, times, how, quiet or as_json)
    told = not (quiet or as_json)
    if told:
        _tell(file, result, timing, how if verbose else None)
    written: list[str] = []
    for name, target in targets.items():
        if write(name, result, target, file.title):
            written.append(str(target))
    for target in written if told else ():
        click.echo(f"  wrote {target}")
    if as_json:
        click.echo(json_text(_known(file, result, times, timing) | {"wrote": written}))
    if interrupted or not ended(result):
        click.echo(
            f"error: stopped at t = {float(result.final_time):.6g} s of "
            f"{float(times[-1]):.6g} s: {result.reason}",
            err=True,
        )
        ctx.exit(INTERRUPTED if interrupted else STOPPED_EARLY)
    if len(written) < len(targets):
        ctx.exit(FAILED)


def _refuse_untold(file: Any, out: Path | None) -> None:
    """Refuse events that a data set could not tell apart, before the run."""
    from ..files.export_events import refuse_names
    from ..files.file_endings import TABLES, ending
    from ..validation.checks import FieldError

    if out is None or ending(out) in TABLES:  # which have no events
        return
    taken = () if file.modes is None else ("switch_time",)
    try:
        refuse_names([event.name for event in file.events], taken)
    except FieldError as refused:
        raise click.UsageError(f"--out {out}: {refused}") from refused


def how_to_run(
    file: Any,
    rtol: float | None,
    atol: float | None,
    max_steps: int,
    method: str | None,
) -> dict[str, Any]:
    """Options of ``rollkane.simulate`` and of ``ensemble``: the file's, or others."""
    return {
        "rtol": rtol or file.rtol,
        "atol": atol or file.atol,
        "max_steps": max_steps,
        "modes": file.modes,
        "method": method or file.method,
        "events": file.events,
        "second_contact": file.second_contact,
    }


def _tell(file: Any, result: Any, timing: _Timing, how: Any) -> None:
    """The summary of a run; with what it was run by, where that is wanted."""
    from ..pictures.summary import summary

    click.echo(file.title)
    timed = f"  {'time':<18}{timing}"
    for line in (*summary(result), *event_lines(result), timed):
        click.echo(line)
    if how is None:
        return
    known = {"loop": f"{result.method}{': ' if result.why else ''}{result.why}"}
    known |= {name: how[name] for name in ("rtol", "atol", "max_steps")}
    for name, value in known.items():
        said = value or "default"
        click.echo(f"  {name.replace('_', ' '):<18}{said}")


def _known(file: Any, result: Any, times: Any, timing: _Timing) -> dict[str, Any]:
    """What ``--json`` prints."""
    import numpy as np

    result = result.with_its_end()
    reached = np.flatnonzero(np.isfinite(np.asarray(result.position)).all(axis=1))
    ends: dict[str, Any] = {"first": {}, "last": {}}
    for name, at in zip(ends, reached[[0, -1]] if reached.size else (), strict=False):
        ends[name]["time"] = np.asarray(result.time)[at]
        for quantity in _TOLD:
            ends[name][quantity] = np.asarray(getattr(result, quantity))[at]
    found: dict[str, Any] = result.events or {}
    return {
        "scene": file.name,
        "title": file.title,
        "code": int(result.code),
        "reason": result.reason,
        "duration": float(times[-1]),
        "final_time": float(result.final_time),
        "steps": int(result.steps),
        "rejected_steps": int(result.rejected_steps),
        "method": result.method,
        "why": result.why,
        **ends,
        "events": {
            name: np.asarray(crossings.times)[: int(crossings.count)]
            for name, crossings in found.items()
        },
        "seconds": timing._asdict(),
    }


def _run(
    file: Any, times: Any, how: dict[str, Any], quiet: bool
) -> tuple[Any, _Timing, bool]:
    """The trajectory, what it took, and whether Ctrl-C ended it."""
    import jax
    import jax.numpy as jnp

    from ..simulation.run import simulate as integrate
    from ..validation.checks import FieldError
    from ..validation.codes import Code

    def timed(watch: Any) -> tuple[Any, float]:
        del watch
        began = time.perf_counter()
        result = integrate(file.scene, file.start, times, **how)
        jax.block_until_ready(result.state)
        return result, time.perf_counter() - began

    def share(watch: Any) -> float:
        return (watch.time - times[0]) / (times[-1] - times[0])

    try:
        (result, first), interrupted = waited(timed, share, quiet)
    except FieldError as error:
        raise click.UsageError(str(error)) from error
    timing = _Timing(math.nan, first)
    if interrupted and int(result.code) == Code.MAX_STEPS:
        code = jnp.asarray(Code.INTERRUPTED, result.code.dtype)
        return dataclasses.replace(result, code=code), timing, True
    if not quiet and first < _SHORT:
        again = timed(None)[1]
        timing = _Timing(max(first - again, 0.0), again)
    return result, timing, False
