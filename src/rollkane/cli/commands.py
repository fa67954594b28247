"""Commands: run a scene, measure it, list, check and describe scenes.

Everything heavy is imported inside the commands, so that ``--help`` answers at once,
and so that JAX is set up before it starts.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from .. import __version__
from ..files.scene_file_limits import MOST_OUTPUTS
from .event_options import ended, event_lines, watched
from .fit_command import fit
from .output_files import check_targets, force_option, telling_of_files, write
from .preparation import BAD_INPUT, STOPPED_EARLY, Positive, loaded, start_jax
from .setup_commands import doctor, new
from .steady_commands import family, steady
from .study_commands import monte_carlo, show

# a run that took this long is not repeated to tell compiling from running [s]
_SHORT = 3.0


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="rollkane")
def main() -> None:
    """Exact dynamics of a rigid body that rolls without slipping."""


for _command in (new, fit, steady, family, monte_carlo, show, doctor):
    main.add_command(_command)


@main.command()
@click.argument("scene")
@click.option("--out", type=click.Path(), help="Table of the motion: .nc, .csv.")
@click.option("--plot", type=click.Path(), help="Picture: spin, tilt, energy, force.")
@click.option("--path", type=click.Path(), help="Picture: path of the contact point.")
@click.option("--view", type=click.Path(), help="HTML page that shows the motion.")
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="PATH=VALUE",
    help="A number in the place of the file's: body.mass=2, start.orientation=[...].",
)
@click.option("--rtol", type=Positive(), help="Relative tolerance of a step.")
@click.option("--atol", type=Positive(), help="Absolute tolerance of a step.")
@click.option("--duration", type=Positive(), help="Time that the motion lasts [s].")
@click.option(
    "--outputs", type=click.IntRange(2, MOST_OUTPUTS), help="Number of output times."
)
@click.option(
    "--max-steps",
    type=click.IntRange(min=1),
    default=10_000_000,
    show_default=True,
    help="Most steps taken.",
)
@click.option(
    "--method",
    type=click.Choice(["auto", "native", "diffrax"]),
    help="The loop in C, diffrax's, or the former where it can.",
)
@click.option(
    "--stop",
    multiple=True,
    help='End the run at an event: "lift-off", or one of SCENE by its name.',
)
@force_option
@click.option("--quiet", "-q", is_flag=True, help="Print nothing but errors.")
@click.pass_context
def simulate(
    ctx: click.Context,
    scene: str,
    out: str | None,
    plot: str | None,
    path: str | None,
    view: str | None,
    changes: tuple[str, ...],
    rtol: float | None,
    atol: float | None,
    duration: float | None,
    outputs: int | None,
    max_steps: int,
    method: str | None,
    stop: tuple[str, ...],
    force: bool,
    quiet: bool,
) -> None:
    """Run SCENE, a built-in scene (see `rollkane scenes`) or a TOML file.

    Exit code 0: done, or ended by an event that was to end it; 2: bad input, nothing
    written; 3: the motion could not be followed to its end, what was reached is
    written.
    """
    asked = {"out": out, "plot": plot, "path": path, "view": view}
    targets = {name: Path(file) for name, file in asked.items() if file is not None}
    check_targets(targets, scene, force=force)
    start_jax()
    file = loaded(ctx, scene, changes)

    import numpy as np

    times = file.times
    if duration is not None or outputs is not None:
        times = np.linspace(0.0, duration or times[-1], outputs or len(times))
    result, timing = _run(
        file.scene,
        file.start,
        times,
        {
            "rtol": rtol or file.rtol,
            "atol": atol or file.atol,
            "max_steps": max_steps,
            "modes": file.modes,
            "method": method or file.method,
            "second_contact": file.second_contact,
            **watched(file, stop),
        },
        quiet,
    )
    if not quiet:
        from ..pictures.summary import summary

        click.echo(file.title)
        for line in (*summary(result), *event_lines(result), timing):
            click.echo(line)
    for name, target in targets.items():
        if write(name, result, target, file.title) and not quiet:
            click.echo(f"  wrote {target}")
    if not ended(result):
        click.echo(
            f"error: stopped at t = {float(result.final_time):.6g} s of "
            f"{float(times[-1]):.6g} s: {result.reason}",
            err=True,
        )
        ctx.exit(STOPPED_EARLY)


@main.command("work-precision")
@click.argument("scene")
@click.option("--horizon", type=Positive(), help="Time that runs last [s].")
@click.option("--solver", "solvers", multiple=True, help="Name of a diffrax solver.")
@click.option(
    "--rtol", "tolerances", type=Positive(), multiple=True, help="Relative tolerance."
)
@click.option(
    "--steps", type=click.IntRange(min=1), multiple=True, help="Number of equal steps."
)
@click.option(
    "--method", "methods", type=click.Choice(["native", "diffrax"]), multiple=True
)
@click.option(
    "--precision", "precisions", type=click.Choice(["double", "single"]), multiple=True
)
@click.option(
    "--coordinates", type=click.Choice(["pole-free", "voronets"]), multiple=True
)
@click.option(
    "--formulation",
    "formulations",
    type=click.Choice(["rolling", "euler_lagrange"]),
    multiple=True,
)
@click.option("--repeats", type=click.IntRange(min=1), default=5, show_default=True)
@click.option(
    "--error",
    type=Positive(),
    default=1e-6,
    show_default=True,
    help="End error for which a solver is recommended.",
)
@click.option("--json", "json_file", type=click.Path(), help="JSON file to write.")
@click.option("--plot", type=click.Path(), help="Picture: error against time.")
@force_option
@click.option("--quiet", "-q", is_flag=True, help="No progress bar.")
@click.pass_context
def work_precision(
    ctx: click.Context,
    scene: str,
    horizon: float | None,
    repeats: int,
    error: float,
    json_file: str | None,
    plot: str | None,
    force: bool,
    quiet: bool,
    **choices: tuple[Any, ...],
) -> None:
    """Measure what accuracy costs for SCENE, and recommend a solver.

    Every option that names a choice may be given several times; left out, solvers
    Tsit5, Dopri5 and Dopri8 run at tolerances from 1e-3 to 1e-12, natively and by
    diffrax.
    """
    asked = {"json": json_file, "plot": plot}
    targets = {name: Path(file) for name, file in asked.items() if file is not None}
    check_targets(targets, scene, force=force)
    start_jax()
    file = loaded(ctx, scene)

    from ..files.atomic_file import write_whole
    from ..studies.work_precision import work_precision as measure
    from ..validation.checks import FieldError

    chosen: dict[str, Any] = {name: value for name, value in choices.items() if value}
    try:
        with click.progressbar(
            length=1, file=sys.stderr, hidden=quiet, show_pos=True
        ) as bar:
            work = measure(
                file,
                horizon=horizon,
                repeats=repeats,
                progress=_shown_by(bar),
                **chosen,
            )
    except FieldError as refused:
        raise click.UsageError(str(refused)) from refused
    click.echo(f"{file.title}: {work.horizon:g} s")
    click.echo(work.table())
    click.echo(f"errors below {work.certainty:.1e} are unknown ({work.reference})")
    with telling_of_files():
        if json_file is not None:
            write_whole(targets["json"], work.to_json().encode())
    if work.failure:
        raise click.ClickException(f"{scene}: {work.failure}")
    try:
        best = work.recommend(error)
        click.echo(
            f"for {error:g}: {best.setting.series}, {best.setting.how}: "
            f"error {best.error:.1e} in {1e3 * best.seconds:.3f} ms"
        )
    except FieldError as refused:
        click.echo(f"for {error:g}: {refused}")
    with telling_of_files():
        if plot is not None:
            work.plot(targets["plot"], file.title)
    for target in targets.values():
        click.echo(f"wrote {target}")


def _shown_by(bar: Any) -> Callable[[int, int, str], None]:
    def progress(done: int, of: int, what: str) -> None:
        bar.length = of
        bar.label = f"{what:<34}"
        bar.update(done - bar.pos)

    return progress


@main.command()
@click.option("--show", metavar="NAME", help="Print the file of one of them.")
@click.pass_context
def scenes(ctx: click.Context, show: str | None) -> None:
    """List the built-in scenes."""
    from ..files.scene_files import SceneFileError, builtin_scenes, scene_text

    if show is not None:
        try:
            click.echo(scene_text(show), nl=False)
        except SceneFileError as error:
            click.echo(str(error), err=True)
            ctx.exit(BAD_INPUT)
        return
    lines = builtin_scenes()
    width = max(map(len, lines))
    for name, description in lines.items():
        click.echo(f"{name:<{width}}  {description}")


@main.command()
@click.argument("scene")
@click.pass_context
def check(ctx: click.Context, scene: str) -> None:
    """Check SCENE, a TOML file: every error at once, with line, value and remedy."""
    start_jax()
    file = loaded(ctx, scene)
    click.echo(
        f"{scene}: good ({file.title}; {len(file.times)} outputs over "
        f"{file.times[-1]:g} s)"
    )


@main.command()
def schema() -> None:
    """Print the JSON schema of a scene file."""
    from ..files.scene_files import scene_schema

    click.echo(json.dumps(scene_schema(), indent=2))


def _run(
    scene: Any, start: Any, times: Any, how: dict[str, Any], quiet: bool
) -> tuple[Any, str]:
    """The trajectory, and a line that tells compiling from running."""
    import jax

    from ..simulation.run import simulate as integrate
    from ..validation.checks import FieldError

    def timed() -> tuple[Any, float]:
        began = time.perf_counter()
        result = integrate(scene, start, times, **how)
        jax.block_until_ready(result.state)
        return result, time.perf_counter() - began

    try:
        result, first = timed()
    except FieldError as error:
        raise click.UsageError(str(error)) from error
    if quiet or first > _SHORT:
        return result, f"  {'time':<18}{first:.2f} s to compile and run"
    _, again = timed()
    compiling = max(first - again, 0.0)
    return (
        result,
        f"  {'time':<18}{compiling:.2f} s to trace and compile, {again:.4f} s to run",
    )
