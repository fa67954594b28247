"""The command that finds parameters of a scene in a file of samples.

Everything heavy is imported inside the functions, as in the other commands.
"""

import contextlib
import sys
import warnings
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import click

from .json_text import json_text
from .named_values import each, pairs, two
from .option_values import quiet_option, refuse
from .output_files import check_targets, force_option, telling_of_files
from .preparation import STOPPED_EARLY, loaded, scene_argument, start_jax

_CHANNELS = (
    ("gyro", "wx,wy,wz", "Angular velocity, body axes."),
    ("accelerometer", "ax,ay,az", "Acceleration less gravity, body axes; see --at."),
    ("position", "x,y,z", "Position of the body origin (or --at), fixed axes."),
    ("orientation", "qw,qx,qy,qz", "Quaternion, scalar first, body to fixed axes."),
    ("marker", "mx,my,mz", "Position of a marker, fixed axes; see --at."),
    ("contact-path", "cx,cy,cz", "Contact point, base axes."),
    ("normal-force", "fn", "Normal force."),
)

STRATEGIES = ("auto", "single", "progressive")
LOSSES = ("linear", "huber", "soft_l1", "cauchy")
FORMS = ("full", "diagonal", "scale", "ratios", "diagonal ratios")
_NAMED = ("sigma", "units", "at", "bounds", "prior", "form")
_LEVEL = 0.95  # probability of profile intervals
# Of the scene's own duration: a longer record may be one of a hundredth of it or more,
# in milliseconds, whose runs, a thousand times as long, take minutes.
_LONG = 10.0


def _channel_options(command: Callable[..., Any]) -> Callable[..., Any]:
    for name, columns, text in reversed(_CHANNELS):
        option = click.option(f"--{name}", metavar=columns.upper(), help=text)
        command = option(command)
    return command


def _several(
    name: str, metavar: str, text: str, required: bool = False
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return click.option(
        name, multiple=True, metavar=metavar, help=text, required=required
    )


@click.command()
@scene_argument
@click.argument("data")
@click.option("--time", default="t", show_default=True, help="Column of times.")
@_channel_options
@_several("--channel", "NAME=COLUMNS", "One more of a kind: marker2=x2,y2,z2.")
@_several("--sigma", "NAME=S", "Standard deviation of its noise; left out: estimated.")
@_several("--units", "NAME=UNIT", "deg/s, g, cm/s2, mm, cm, kN; time=ms.")
@_several("--at", "NAME=X,Y,Z", "Where a sensor sits, body axes [m].")
@click.option("--between", metavar="T0,T1", help="First and last time used [s].")
@_several(
    "--free",
    "PATH",
    "A number to find, as body.inertia or gyro.bias; start.angular_velocity is along "
    "body axes.",
    required=True,
)
@_several("--bounds", "PATH=LOW,HIGH", "Its bounds; either may be left empty.")
@_several("--prior", "PATH=MEAN,SD", "What was known of it before.")
@_several("--form", "PATH=FORM", f"One of: {', '.join(FORMS)}.")
@click.option(
    "--strategy",
    type=click.Choice(STRATEGIES),
    default="auto",
    show_default=True,
    help="The whole record at once, or growing parts.",
)
@click.option(
    "--loss",
    type=click.Choice(LOSSES),
    default="linear",
    show_default=True,
    help="Of misfits: all but the first weigh outliers less.",
)
@click.option(
    "--starts",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Guesses: the scene's, and random ones around it.",
)
@click.option(
    "--max-evaluations",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    help="Points tried by each search.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Of the random ones.",
)
@click.option(
    "--profile", is_flag=True, help="95 % intervals by profiles of chi-square."
)
@click.option("--json", "json_file", type=click.Path(), help="JSON file to write.")
@click.option("--report", type=click.Path(), help="HTML page to write.")
@click.option("--plot", type=click.Path(), help="Picture: samples, misfits.")
@force_option
@quiet_option
@click.pass_context
def fit(
    ctx: click.Context,
    scene: str,
    data: str,
    json_file: str | None,
    report: str | None,
    plot: str | None,
    profile: bool,
    force: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Find numbers of SCENE in DATA, a CSV or NetCDF file of samples.

    SCENE is a built-in scene or a TOML file; its values are the first guess, its start
    holds at the first sample that is used. DATA says how long it runs: SCENE's events,
    duration, outputs and second_contact are not used.

    \b
    rollkane fit rattleback run.csv --gyro wx,wy,wz --sigma gyro=0.02 \\
        --free body.inertia --free start.angular_velocity --report fit.html

    Exit code 0: done; 2: bad input, nothing written; 3: it did not converge, what was
    found is written.
    """
    asked = {"json": json_file, "report": report, "plot": plot}
    targets = {name: Path(file) for name, file in asked.items() if file is not None}
    check_targets(targets, scene, data, force=force)
    if profile and options["loss"] != "linear":
        refuse("--profile", "is of chi-square, and so of --loss linear alone")
    named = {name: pairs(name, options[name]) for name in (*_NAMED, "channel")}
    start_jax()
    file = loaded(ctx, scene)

    from ..validation.checks import FieldError

    try:
        with _telling_warnings(), _progress(quiet) as progress:
            found = _found(file, data, named, options, progress)
            ends = _profiles(found) if profile else {}
    except (FieldError, ImportError) as refused:
        raise click.UsageError(str(refused)) from refused
    if not quiet:
        click.echo(file.title)
        click.echo(found.report())
        for line in _told(found, ends) + _start_told(found):
            click.echo(line)
    _write(found, ends, targets, file.title, quiet)
    if not found.converged:
        remedy = "begin nearer, use less of the record, or give more --starts"
        click.echo(f"error: the fit did not converge; {remedy}", err=True)
        ctx.exit(STOPPED_EARLY)


def _found(
    file: Any,
    data: str,
    named: dict[str, dict[str, str]],
    options: dict[str, Any],
    progress: Callable[[int, float], None] | None,
) -> Any:
    """The fit."""
    from ..files.records import read_record
    from ..identification.fitting import fit as find
    from ..uncertainty.scene_model import started_at

    def own(option: str) -> dict[str, str]:
        return {name.replace("-", "_"): text for name, text in named[option].items()}

    kinds = [name.replace("-", "_") for name, *_ in _CHANNELS]
    columns = {name: options[name] for name in kinds if options[name]}
    more = own("channel")
    for name in more.keys() & columns.keys():
        refuse("--channel", f"names {name}, which an option of its own gives, too")
    columns |= more
    between = options["between"]
    record = read_record(
        data,
        options["time"],
        sigma={name: each("sigma", text) for name, text in own("sigma").items()},
        units=own("units"),
        at={name: each("at", text) for name, text in own("at").items()},
        between=two("between", between) if between else None,
        **{
            name: [c.strip() for c in text.split(",")] for name, text in columns.items()
        },
    )
    _hint_of_times(float(record.time[-1] - record.time[0]), file.times)
    return find(
        file.scene,
        started_at(file, float(record.start_time)),
        record,
        _free(options["free"], named),
        modes=file.modes,
        loss=options["loss"],
        strategy=options["strategy"],
        starts=options["starts"],
        seed=options["seed"],
        max_evaluations=options["max_evaluations"],
        rtol=file.rtol,
        atol=file.atol,
        method=file.method,
        progress=progress,
    )


def _hint_of_times(lasts: float, times: Any) -> None:
    """Warn of a record that lasts as if its times had another unit."""
    own = float(times[-1] - times[0])
    if lasts > _LONG * own:
        warnings.warn(
            f"DATA lasts {lasts:.6g} s, and SCENE runs for {own:.6g} s: if its times "
            "are milliseconds, give --units time=ms",
            stacklevel=2,
        )


def _free(paths: Sequence[str], named: dict[str, dict[str, str]]) -> list[Any]:
    """The parameters, with what options say of them."""
    from ..identification.parameters import Free

    for option in ("bounds", "prior", "form"):
        for path in named[option]:
            if path not in paths:
                refuse(f"--{option}", f"{path} is not free; give --free {path}, too")
    found: list[Any] = []
    for path in paths:
        bounds, prior = named["bounds"].get(path), named["prior"].get(path)
        given = None
        if prior is not None:
            mean, deviation = two("prior", prior)
            if mean is None or deviation is None:
                refuse("--prior", f"{prior!r} wants a mean and a standard deviation")
            given = mean, deviation
        limits = None if bounds is None else two("bounds", bounds)
        found.append(Free(path, limits, given, named["form"].get(path)))
    return found


@contextlib.contextmanager
def _progress(
    quiet: bool,
) -> Generator[Callable[[int, float], None] | None, None, None]:
    """What tells of a search while it lasts, where someone sees it."""
    if quiet or not sys.stderr.isatty():
        yield None
        return

    def told(rollouts: int, chi2: float) -> None:
        click.echo(f"\r  runs {rollouts}, chi2 {chi2:<14.6g}", err=True, nl=False)

    yield told
    click.echo(f"\r{'':40}\r", err=True, nl=False)


@contextlib.contextmanager
def _telling_warnings() -> Generator[None, None, None]:
    """Warnings as sentences, at once."""

    def told(message: Warning | str, *_: Any) -> None:
        click.echo(f"warning: {message}", err=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = told
        yield


def _profiles(found: Any) -> dict[str, Any]:
    """Ends of intervals by path; infinite for what is not seen."""
    import numpy as np

    ends: dict[str, Any] = {}
    for path, errors in found.standard_errors.items():
        low, high = found.interval(path, _LEVEL, "profile")
        hidden = np.isinf(errors)
        ends[path] = np.where(hidden, -np.inf, low), np.where(hidden, np.inf, high)
    return ends


def _told(found: Any, ends: dict[str, Any]) -> list[str]:
    """A line for the interval of each entry."""
    import numpy as np

    from ..identification.transforms import entries

    lines = ["", "  95 % intervals by profiles of chi2:"] if ends else []
    for path, (low, high) in ends.items():
        labels = entries(low.shape)
        told = zip(labels, low.ravel(), high.ravel(), strict=True)
        symmetric = low.shape == (3, 3) and np.array_equal(low, low.T)
        upper = np.triu(np.ones((3, 3), bool)).ravel()
        for k, (label, least, most) in enumerate(told):
            if not symmetric or upper[k]:
                lines.append(f"  {path + label:<36}{least:>14.6g}{most:>14.6g}")
    return lines


def _start(found: Any) -> dict[str, Any]:
    """The start with the estimates, as ``[start]`` of a scene file has it."""
    from ..files.scene_files.start_reading import start_table

    return start_table(found.scene, found.record.start_time, found.start)


def _start_told(found: Any) -> list[str]:
    """It in TOML, where it was looked for: in a scene file axes are others."""
    own = [path for path in found.estimates if path.startswith("start.")]
    if not own:
        return []
    lines = ["", "  for a scene file, whose angular velocity is along fixed axes:"]
    lines.append("  [start]")
    return lines + [f"  {name} = {x.tolist()}" for name, x in _start(found).items()]


def _write(
    found: Any, ends: dict[str, Any], targets: dict[str, Path], title: str, quiet: bool
) -> None:
    """Each file, whole or not at all."""
    from ..files.atomic_file import write_whole

    with telling_of_files():
        if "json" in targets:
            write_whole(targets["json"], json_text(_json(found, ends)).encode())
        if "report" in targets:
            found.write_report(targets["report"], title)
        if "plot" in targets:
            found.plot(targets["plot"], title)
    for target in targets.values() if not quiet else ():
        click.echo(f"  wrote {target}")


def _json(found: Any, ends: dict[str, Any]) -> dict[str, Any]:
    """The fit by names."""
    known: dict[str, Any] = {
        "estimates": found.estimates,
        "standard_errors": found.standard_errors,
        "names": found.names,
        "covariance": found.covariance,
        "sigma": found.sigma,
        "chi2": found.chi2,
        "degrees_of_freedom": found.degrees_of_freedom,
        "converged": found.converged,
        "rollouts": found.rollouts,
        "unseen": found.unseen,
        "start": _start(found),
    }
    if ends:
        known["intervals"] = ends
    return known
