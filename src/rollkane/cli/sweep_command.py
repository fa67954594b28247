"""The command that runs a scene for ranges of its numbers.

Everything heavy is imported inside the functions, as in the other commands.
"""

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .json_text import json_text
from .option_values import quiet_option, refuse, verbose_option
from .output_files import check_targets, force_option, telling_of_files
from .preparation import (
    BAD_INPUT,
    STOPPED_EARLY,
    changes_of,
    loaded,
    scene_argument,
    start_jax,
    with_run,
)
from .simulate_command import how_to_run, run_options, set_option
from .sweep_points import Group, Point, Varied, groups_of, stacked, varied
from .waiting import INTERRUPTED, waited

if TYPE_CHECKING:  # it imports NumPy
    from .sweep_result import Swept

_BLOCK = 64  # members that Ctrl-C loses at most, for each processor
_LEAST, _BLOCKS = 8, 16  # members of a block, as many as there are lanes; blocks
_SHOWN = 20  # lines of the table
_UNITS = {
    "position": "m",
    "orientation": "1",
    "angular_velocity": "rad/s",
    "spin": "rad/s",
    "tilt": "rad",
    "contact_on_base": "m",
    "energy": "J",
    "normal_force": "N",
    "friction_ratio": "1",
    "outward": "1",
}


@click.command()
@scene_argument
@click.option(
    "--vary",
    "over",
    required=True,
    multiple=True,
    metavar="PATH=LOW:HIGH:COUNT",
    help="body.mass=1:2:11, or the values: body.mass=1,2,5. Several make a grid.",
)
@click.option(
    "--observe",
    multiple=True,
    type=click.Choice(list(_UNITS)),
    default=("spin",),
    show_default=True,
    help="What is looked at; several times for more.",
)
@click.option("--out", type=click.Path(), help="Table: .csv; over time, too: .nc.")
@click.option("--plot", type=click.Path(), help="Picture of one or two that vary.")
@set_option
@run_options
@force_option
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
@quiet_option
@verbose_option
@click.pass_context
def sweep(
    ctx: click.Context,
    scene: str,
    over: tuple[str, ...],
    observe: tuple[str, ...],
    out: str | None,
    plot: str | None,
    changes: tuple[str, ...],
    force: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """Run SCENE for ranges of its numbers, as one ensemble.

    \b
    rollkane sweep rattleback --vary "start.angular_velocity[2]=1:8:29" \\
        --observe spin --observe tilt --out table.csv --plot sweep.png

    Of what is observed the table has the last value, the least and the greatest at the
    output times; of each event of SCENE how often it happened, and when first [s]. Exit
    codes as of simulate; at Ctrl-C the points that were done are kept, the others are
    "not run".
    """
    asked = {"out": out, "plot": plot}
    targets = {name: Path(file) for name, file in asked.items() if file is not None}
    check_targets(targets, scene, force=force)
    ranges = varied(over)
    _refuse_undone(changes, ranges, options)
    if plot is not None and len(ranges) > 2:
        problem = f"draws one or two numbers that vary, not {len(ranges)}; use --out"
        raise click.BadParameter(problem, param_hint="'--plot'")
    start_jax()
    changes = with_run(changes, options)
    file = loaded(ctx, scene, changes)
    groups = groups_of(scene, changes, ranges)
    if isinstance(groups, Point):
        _refuse_point(groups, scene)
        ctx.exit(BAD_INPUT)
    swept, interrupted = _swept(
        groups, ranges, _observing(observe), options, quiet or as_json, out
    )
    _show(swept, file.title, as_json, quiet, verbose)
    with telling_of_files():
        for name, target in targets.items():
            _write(name, swept, target, file.title)
            if not (quiet or as_json):
                click.echo(f"  wrote {target}")
    _end(ctx, swept, interrupted)


def _refuse_undone(
    changes: tuple[str, ...], over: list[Varied], options: dict[str, Any]
) -> None:
    """Refuse to vary what another option sets for all points."""
    from ..files.scene_files.changes import same_field, undone

    for one in over:
        for name, value in options.items():
            if value is not None and same_field(one.path, ("run", name)):
                problem = f"varies {one.path}, which --{name} sets for all points"
                refuse("--vary", problem)
        # those that are set are put first
        lost = undone([*changes_of(changes), one.path])
        if lost is not None:
            problem = f"varies {one.path}, and --set sets {lost[0]} for all points"
            refuse("--vary", problem)


def _refuse_point(point: Point, scene: str) -> None:
    told = ", ".join(f"{path} = {value}" for path, value in point.values.items())
    click.echo(f"{point.error}\nerror in {scene} at {told}", err=True)


def _end(ctx: click.Context, swept: "Swept", interrupted: bool) -> None:
    """Say how many ended otherwise than they should, and exit."""
    count = len(swept.outcome)
    if interrupted:
        done = count - swept.not_run
        click.echo(f"stopped: {done} of {count} points were kept", err=True)
        ctx.exit(INTERRUPTED)
    early = count - int(swept.ended.sum())
    if early:
        told = f"error: {early} of {count} motions ended early: see outcome"
        click.echo(told, err=True)
        ctx.exit(STOPPED_EARLY)


def _observing(names: tuple[str, ...]) -> Any:
    """One function for all points: what it is compiled to is known by it."""
    from ..dynamics.ready_observables import READY

    def observed(scene: Any, t: Any, state: Any) -> dict[str, Any]:
        return {name: READY[name](scene, t, state) for name in dict.fromkeys(names)}

    return observed


def _refuse_untold(groups: list[Group], times: list[Any], out: str | None) -> None:
    """What the files of a sweep cannot tell."""
    import numpy as np

    from ..files.export_events import variable_of
    from ..files.file_endings import TABLES, ending

    for group in groups:
        names = [variable_of(event.name) for event in group.files[0].events]
        if "final" in names:
            problem = "an event is called 'final', and final_time is the motion's end"
            raise click.UsageError(f"{problem}: give it another name")
        if len({*names}) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            problem = f"two events would have the columns of {twice!r}"
            raise click.UsageError(f"{problem}: give one of them another name")
    one_axis = all(np.array_equal(times[0], own) for own in times)
    if not one_axis and out is not None and ending(Path(out)) not in TABLES:
        refuse("--out", f"{out}: points have output times of their own; write a .csv")


def _swept(
    groups: list[Group],
    over: list[Varied],
    observe: Any,
    options: dict[str, Any],
    quiet: bool,
    out: str | None,
) -> tuple["Swept", bool]:
    """The motions of all points, or of those that were done before Ctrl-C."""
    import numpy as np

    from ..validation.checks import FieldError
    from .sweep_result import joined

    count = sum(len(group.places) for group in groups)
    times = [group.files[0].times for group in groups]
    _refuse_untold(groups, times, out)
    done: list[tuple[Any, Any]] = []

    def work(watch: Any) -> None:
        for group, own in zip(groups, times, strict=True):
            for places, block in _blocks(group, own, observe, options):
                if watch.ends:  # what it has is half of it
                    return
                done.append((places, block))

    def share(watch: Any) -> float:
        del watch
        return sum(len(places) for places, _ in done) / count or math.nan

    try:
        interrupted = waited(work, share, quiet).interrupted
    except FieldError as refused:
        raise click.UsageError(str(refused)) from refused
    if not done:
        raise KeyboardInterrupt
    one_axis = all(np.array_equal(times[0], own) for own in times)
    time = times[0] if one_axis else None
    return joined(over, time, count, done, observe), interrupted


def _blocks(
    group: Group, times: Any, observe: Any, options: dict[str, Any]
) -> Iterator[tuple[Any, Any]]:
    """Blocks of an ensemble, each with the numbers of its points."""
    import numpy as np

    from ..simulation.ensembles import ensemble_blocks

    scene, axes = stacked([file.scene for file in group.files])
    starts = [file.start for file in group.files]
    places = np.asarray(group.places)
    fair = max(_LEAST, -(-len(places) // _BLOCKS))
    how = how_to_run(group.files[0], **options)
    how |= {"scene_axes": axes, "block": min(_BLOCK, fair, len(places))}
    for block in ensemble_blocks(scene, starts, times, observe=observe, **how):
        yield places[block.members], block


def _show(
    swept: "Swept", title: str, as_json: bool, quiet: bool, verbose: bool
) -> None:
    columns = swept.columns
    if as_json:
        click.echo(json_text({"title": title, "columns": columns}))
        return
    if quiet:
        return
    click.echo(title)
    rows = list(zip(*(x.tolist() for x in columns.values()), strict=True))
    shown = [
        [x if isinstance(x, str) else f"{x:.6g}" for x in row] for row in rows[:_SHOWN]
    ]
    widths = [max(map(len, column)) for column in zip(columns, *shown, strict=True)]
    for row in (list(columns), *shown):
        cells = zip(row, widths, strict=True)
        click.echo("  " + "  ".join(f"{text:>{width}}" for text, width in cells))
    if len(rows) > _SHOWN:
        click.echo(f"  ... {len(rows) - _SHOWN} more; --out writes them")
    for loop in swept.loops if verbose else ():
        click.echo(f"  loop {loop}")


def _write(name: str, swept: "Swept", target: Path, title: str) -> None:
    from ..files.atomic_file import write_whole
    from ..files.file_endings import TABLES, ending

    if name == "plot":
        from ..pictures.plot_sweep import plot_sweep

        grids = [(one.path, one.values) for one in swept.over]
        plot_sweep(grids, swept.columns, _UNITS, target, title)
    elif ending(target) in TABLES:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(swept.columns)
        columns = (x.tolist() for x in swept.columns.values())
        writer.writerows(zip(*columns, strict=True))
        write_whole(target, text.getvalue().encode())
    else:
        from ..files.sweep_table import write_sweep

        grids = [(one.path, one.values) for one in swept.over]
        ends = swept.events | swept.ends
        write_sweep(target, grids, swept.time, swept.observed, ends, _UNITS, title)
