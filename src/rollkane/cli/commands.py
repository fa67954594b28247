"""Commands: run a scene, measure it, list, check and describe scenes.

Everything heavy is imported inside the commands, so that ``--help`` answers at once,
and so that JAX is set up before it starts.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from .. import __version__
from .fit_command import fit
from .json_text import json_text
from .live_command import live
from .option_values import quiet_option
from .output_files import check_targets, force_option, telling_of_files
from .preparation import BAD_INPUT, Positive, loaded, scene_argument, start_jax
from .setup_commands import doctor, new
from .simulate_command import simulate
from .steady_commands import family, steady
from .study_commands import monte_carlo, show
from .sweep_command import sweep
from .waiting import INTERRUPTED


class _Commands(click.Group):
    """Commands that all answer Ctrl-C with the same exit code."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("stopped: nothing was written", err=True)
            ctx.exit(INTERRUPTED)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="rollkane")
def main() -> None:
    """Exact dynamics of a rigid body that rolls without slipping."""


for _command in (
    simulate,
    sweep,
    live,
    new,
    fit,
    steady,
    family,
    monte_carlo,
    show,
    doctor,
):
    main.add_command(_command)


@main.command("work-precision")
@scene_argument
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
    diffrax. SCENE's events, second_contact and tolerances are not used.
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
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
@click.pass_context
def scenes(ctx: click.Context, show: str | None, as_json: bool) -> None:
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
    if as_json:
        click.echo(json_text(lines))
        return
    width = max(map(len, lines))
    for name, description in lines.items():
        click.echo(f"{name:<{width}}  {description}")


@main.command()
@scene_argument
@click.option("--json", "as_json", is_flag=True, help="Print what is found as JSON.")
@quiet_option
@click.pass_context
def check(ctx: click.Context, scene: str, as_json: bool, quiet: bool) -> None:
    """Check SCENE, a TOML file: every error at once, with line, value and remedy.

    Exit code 0: good; 2: not, and told why.
    """
    start_jax()
    if as_json:
        _check_as_json(ctx, scene)
        return
    file = loaded(ctx, scene)
    if quiet:
        return
    click.echo(
        f"{scene}: good ({file.title}; {len(file.times)} outputs over "
        f"{file.times[-1]:g} s)"
    )


def _check_as_json(ctx: click.Context, scene: str) -> None:
    from ..files.scene_files import SceneFileError, load_scene

    try:
        file = load_scene(scene)
    except SceneFileError as error:
        problems = [vars(problem) for problem in error.problems]
        click.echo(json_text({"scene": scene, "good": False, "problems": problems}))
        ctx.exit(BAD_INPUT)
    known = {"title": file.title, "outputs": len(file.times)}
    known |= {"duration": float(file.times[-1]), "problems": []}
    click.echo(json_text({"scene": scene, "good": True, **known}))


@main.command()
def schema() -> None:
    """Print the JSON schema of a scene file."""
    from ..files.scene_files import scene_schema

    click.echo(json.dumps(scene_schema(), indent=2))
