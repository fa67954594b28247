"""Commands that find steady motions of a scene, and families of them.

Everything heavy is imported inside the functions, as in the other commands.
"""

import functools
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import click

from .json_text import json_text
from .option_values import finite_number, quiet_option, refuse
from .output_files import check_targets, force_option, telling_of_files
from .preparation import loaded, scene_argument, start_jax

# held in this order, until a branch is left
_USUAL = ("tilt", "spin", "speed", "energy")


def _hold_option(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--hold",
        multiple=True,
        metavar="NAME[=VALUE]",
        help="speed, tilt, spin, energy, ...: its value, or that of the start.",
    )(command)


_json_option = click.option(
    "--json",
    "json_file",
    type=click.Path(allow_dash=True),
    help="JSON file to write; - prints it, and nothing else.",
)


@click.command()
@scene_argument
@_hold_option
@click.option("--energy-sign", is_flag=True, help="Tell that of the kept energy, too.")
@_json_option
@force_option
@quiet_option
@click.pass_context
def steady(
    ctx: click.Context,
    scene: str,
    hold: tuple[str, ...],
    energy_sign: bool,
    json_file: str | None,
    force: bool,
    quiet: bool,
) -> None:
    """Find the steady motion of SCENE near its start, and its stability.

    \b
    rollkane steady rolling-disc --hold speed=1.5 --hold tilt

    The contact never changes: SCENE's [modes] are left out, and told where they would
    not let the motion be; its events and its [run] are not used.

    Exit code 0: done; 2: bad input, or no steady motion; nothing is written then.
    """
    targets = {} if json_file in (None, "-") else {"json": Path(json_file)}
    check_targets(targets, scene, force=force)
    held, printed = _held(hold), json_file == "-"
    start_jax()
    file = loaded(ctx, scene)

    from ..stability.steady import steady_motion
    from ..validation.checks import FieldError

    try:
        motion = steady_motion(file.scene, file.start, held)
    except FieldError as refused:
        raise click.UsageError(str(refused)) from refused
    known = _motion_json(motion) | {"start": _start_json(file.scene, motion.state)}
    if energy_sign:
        known["energy_sign"] = _sign_json(motion.energy_sign)
    _tell_modes(file, [motion.state], quiet)
    if printed:
        click.echo(json_text(known))
        return
    if not quiet:
        click.echo(file.title)
        click.echo(str(motion))
    _write_json(targets, known, quiet)


@click.command()
@scene_argument
@click.option(
    "--vary",
    required=True,
    metavar="NAME=LOW:HIGH",
    help="start.spin=1:20, hold.tilt=0.2:1.5, body.mass=0.5:2.",
)
@_hold_option
@click.option(
    "--points",
    type=click.IntRange(min=2),
    default=100,
    show_default=True,
    help="How many steps the range is wide, at least.",
)
@click.option("--show", metavar="NAME", help="What the diagram shows; growth.")
@click.option("--plot", type=click.Path(), help="Picture: the diagram.")
@_json_option
@force_option
@quiet_option
@click.pass_context
def family(
    ctx: click.Context,
    scene: str,
    vary: str,
    hold: tuple[str, ...],
    points: int,
    show: str | None,
    plot: str | None,
    json_file: str | None,
    force: bool,
    quiet: bool,
) -> None:
    """Follow the steady motions of SCENE through a range of a number.

    \b
    rollkane family rolling-disc --vary start.spin=1:20 --plot disc.png

    What else is free is held as it is in the start, and told: tilt, spin, speed or
    energy, unless --hold says otherwise. [modes] and exit codes as of steady.
    """
    printed = json_file == "-"
    asked = {"json": None if printed else json_file, "plot": plot}
    targets = {name: Path(file) for name, file in asked.items() if file is not None}
    check_targets(targets, scene, force=force)
    held, (name, span) = _held(hold), _range(vary)
    start_jax()
    file = loaded(ctx, scene)

    from ..stability.families import steady_family
    from ..validation.checks import FieldError

    try:
        motion = _on_branch(file, held, name, span)
        if not name.startswith(("hold.", "start.")):
            path = name
        else:
            path = f"hold.{name.partition('.')[2]}"
        branch = steady_family(file.scene, motion, path, span, points=points)
        if "plot" in targets:
            _plotted(branch, targets["plot"], show, file.title)
    except (FieldError, ImportError) as refused:
        raise click.UsageError(str(refused)) from refused
    # along a number of the scene each point has a scene of its own
    same = branch.vary.startswith("hold.")
    _tell_modes(file, [p.state for p in branch.points] if same else [], quiet)
    if printed:
        click.echo(json_text(_branch_json(branch, motion)))
        return
    if not quiet:
        click.echo(file.title)
        _tell(branch, motion)
    _write_json(targets, _branch_json(branch, motion), quiet)


def _plotted(branch: Any, path: Path, show: str | None, title: str) -> None:
    from ..pictures.plot_family import plot_family

    with telling_of_files():
        plot_family(branch, path, show, title)


def _held(given: Sequence[str]) -> dict[str, float | None]:
    """What ``--hold`` says, by name."""
    found: dict[str, float | None] = {}
    for one in given:
        name, equals, text = one.partition("=")
        if name in found:
            refuse("--hold", f"names {name} twice")
        found[name] = finite_number("--hold", text) if equals else None
    return found


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, equals, span = text.partition("=")
    low, colon, high = span.partition(":")
    if not (equals and colon and name):
        refuse("--vary", f"{text!r} is not NAME=LOW:HIGH")
    return name, (finite_number("--vary", low), finite_number("--vary", high))


def _on_branch(
    file: Any, held: dict[str, float | None], name: str, span: tuple[float, float]
) -> Any:
    """A steady motion on the branch, with as much held as leaves one."""
    from ..stability.steady import steady_motion
    from ..validation.checks import FieldError

    low, high = min(span), max(span)
    varied = name.partition(".")[2] if name.startswith(("hold.", "start.")) else None
    if varied is not None:
        held = {varied: None} | held
        value = held[varied]
        if value is not None and not low <= value <= high:
            told = f"holds {varied} at {value:g}, which --vary takes from {low:g} to"
            refuse("--hold", f"{told} {high:g}: leave it out, or begin inside")
    motion = steady_motion(file.scene, file.start, held)
    if varied is not None and not low <= motion.held[varied] <= high:
        value = min(max(motion.held[varied], low), high)
        motion = steady_motion(file.scene, motion.state, held | {varied: value})
    held = dict(motion.held)
    for more in _USUAL:
        if motion.family <= len(held):
            break
        if more in held:
            continue
        try:  # as it is in the start, not where the motion went that left it free
            motion = steady_motion(file.scene, file.start, held | {more: None})
        except FieldError:
            continue
        held |= {more: motion.held[more]}
    return motion


def _tell(branch: Any, motion: Any) -> None:
    for name, value in motion.held.items():
        if f"hold.{name}" != branch.vary:
            click.echo(f"  held {name} = {value:.9g}")
    click.echo(str(branch))
    names = [branch.vary.removeprefix("hold."), *motion.generator]
    click.echo("  " + " ".join(f"{n:>18.18}" for n in names) + "      growth [1/s]")
    every = max(1, len(branch.points) // 12)
    for point in branch.points[::every]:
        row = [point.value, *point.generator.values()]
        growth = max((v.real for v in point.eigenvalues), default=0.0)
        said = "stable" if point.stable else f"{growth:.6g}"
        click.echo("  " + " ".join(f"{v:>18.9g}" for v in row) + f"{said:>18}")


def _tell_modes(file: Any, states: Sequence[Any], quiet: bool) -> None:
    """Say that modes are left out, and of how many states they would make another one.

    Args:
        file: The scene file.
        states: Of steady motions of its scene, in which the body rolls.
        quiet: Whether nothing but what is wrong is told.
    """
    if file.modes is None:
        return
    if not quiet:
        click.echo("note: [modes] are left out: the body rolls throughout", err=True)
    for how, count in (_ended_by(file, states) if states else {}).items():
        which = (
            "the motion" if len(states) == 1 else f"{count} of {len(states)} motions"
        )
        if count:
            click.echo(f"warning: with [modes] {which} would {how}", err=True)


def _ended_by(file: Any, states: Sequence[Any]) -> dict[str, int]:
    """How many steady motions modes would end, by what they would do."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from ..dynamics.observables import friction_ratio, normal_force

    def seen(state: Any) -> Any:
        at = file.scene, jnp.zeros(()), state
        return normal_force(*at), friction_ratio(*at)

    found: Any = jax.jit(seen)
    pairs: list[Any] = [found(state) for state in states]
    force, ratio = np.array(pairs).T
    pulls = force < 0.0
    sticking = file.modes.sticking
    slips = ~pulls & (ratio > (np.inf if sticking is None else float(sticking)))
    counts = {"lift off": pulls & file.modes.lifts, "slip": slips}
    return {how: int(np.sum(which)) for how, which in counts.items()}


def _motion_json(motion: Any) -> dict[str, Any]:
    return {
        "state": _numbers(motion.state),
        "generator": motion.generator,
        "held": motion.held,
        "eigenvalues": [_pair(v) for v in motion.eigenvalues],
        "zeros": {name: _pair(v) for name, v in motion.zeros.items()},
        "stable": motion.stable,
        "family": motion.family,
    }


def _start_json(scene: Any, state: Any) -> dict[str, Any]:
    """A state as the table ``[start]`` of a scene file has it."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from ..files.scene_files.start_reading import start_table

    found = functools.partial(start_table, scene, jnp.zeros(()))
    start = cast("dict[str, Any]", jax.jit(found)(state))
    return {name: np.asarray(x).tolist() for name, x in start.items()}


def _sign_json(sign: Any) -> dict[str, Any]:
    return sign._asdict() | {"definite": sign.definite}


def _branch_json(branch: Any, motion: Any) -> dict[str, Any]:
    return {
        "vary": branch.vary,
        "held": {n: v for n, v in motion.held.items() if f"hold.{n}" != branch.vary},
        "points": [
            {
                "value": p.value,
                "state": _numbers(p.state),
                "generator": p.generator,
                "eigenvalues": [_pair(v) for v in p.eigenvalues],
                "stable": p.stable,
            }
            for p in branch.points
        ],
        "ends": list(branch.ends),
        "critical": [
            {
                "kind": c.kind,
                "value": c.value,
                "eigenvalue": _pair(c.eigenvalue),
                "state": _numbers(c.state),
            }
            for c in branch.critical
        ],
    }


def _pair(value: complex) -> list[float]:
    return [float(value.real), float(value.imag)]


def _numbers(state: Any) -> dict[str, list[float]]:
    import dataclasses

    import numpy as np

    return {
        field.name: np.asarray(getattr(state, field.name)).tolist()
        for field in dataclasses.fields(state)
    }


def _write_json(targets: Mapping[str, Path], known: Any, quiet: bool) -> None:
    """The JSON file, whole or not at all, and what was written."""
    from ..files.atomic_file import write_whole

    with telling_of_files():
        if "json" in targets:
            text = json.dumps(known, indent=2, allow_nan=False)
            write_whole(targets["json"], text.encode())
    for target in targets.values() if not quiet else ():
        click.echo(f"  wrote {target}")
