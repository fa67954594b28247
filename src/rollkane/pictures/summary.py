"""A run in a few lines: what it did, how exact it is, and what it needed."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..dynamics.rolling import contact_of, rolling_derivative
from ..dynamics.rolling_body_observables import paths_of_rolling
from ..dynamics.scene import Scene
from ..geometry.small_linear import dot
from ..hybrid.modes import Switches
from ..simulation.trajectory import Trajectory
from .motion_samples import MotionSamples, motion_samples, spans
from .summary_by_kind import (
    DOES,
    line,
    mode_line,
    path_line,
    what_happened,
    work_line,
)

_MOST_LISTED = 12
_SIDE = 0.2  # of the largest spin: a ripple about zero that is smaller turns nothing
_WHAT_REVERSES = (
    f"(last zeros before more than {100 * _SIDE:g} % of the largest the other way)"
)
_ROUNDING = 1e-9  # of the largest angular speed: a smaller spin has no sign to change
_NO_WEIGHT = 1e-12  # [m/s^2], far below any load, above rounding
_NO_FRICTION = 1e-12  # rounding of forces
_SHOWN = 8  # changes of the contact
_CLOSE = 1e-9  # of the spacing of the samples


def summary(trajectory: Trajectory) -> list[str]:
    """Describe a single run.

    Args:
        trajectory: One run, not a batch.

    Returns:
        Lines: spin about the base's normal and about the body's axis next to it
        [rad/s] before and after, when they reversed [s], other than by a ripple about
        zero, where the body's origin came to [m], what happened by kind of scene
        (:func:`rollkane.pictures.summary_by_kind.what_happened`), relative drift of the
        energy that has to be kept [1] or how it changed [J], when the contact changed
        [s] in a run with ``modes`` and how long it rolled, slipped and flew, steps, the
        normal force while there is a contact [N] (or when it would first have had to
        pull), the friction coefficient that rolling needed [1], and of each body that
        rolls on or in the body where it came to, the path of its contact on its carrier
        [m] and its normal force [N]. All at the outputs that the run reached, and
        where it ended.

    Raises:
        FieldError: a batch.
    """
    trajectory = trajectory.with_its_end()
    motion = motion_samples(trajectory)
    rows = np.nonzero(motion.reached)[0]
    lines: list[str] = []
    if rows.size:
        motion = motion.rows(rows)
        lines += _spin_lines(trajectory, motion, rows)
        lines.append(_place_line(motion))
        lines += what_happened(trajectory, motion)
        lines.append(_energy_line(trajectory, motion))
    steps, rejected = int(trajectory.steps), int(trajectory.rejected_steps)
    lines += _switch_lines(trajectory.switches) + mode_line(trajectory)
    loop = "in C" if trajectory.method == "native" else "by diffrax"
    if trajectory.switches is not None:
        loop = "with modes"
    lines.append(line("steps", f"{steps} accepted, {rejected} rejected, {loop}"))
    count = np.size(trajectory.time)
    lines.append(line("outputs", f"{count}; least, most and reversals are by these"))
    if rows.size:
        lines += _force_lines(trajectory, motion)
        for k, path in enumerate(paths_of_rolling(trajectory.scene)):
            lines += _rolling_lines(motion, k, path)
    return lines


def _switch_lines(switches: Switches | None) -> list[str]:
    """The first changes of the contact, and how many more there were."""
    if switches is None:
        return []
    count = int(switches.count)
    if not count:
        return [line("contact", "never changed")]
    times, before, after = map(
        np.asarray, (switches.time, switches.before, switches.after)
    )
    lines = [
        line(
            "contact" if i == 0 else "",
            f"{DOES[before[i]]} -> {DOES[after[i]]} at t = {times[i]:.6g} s",
        )
        for i in range(min(count, _SHOWN))
    ]
    more = count - len(lines)
    return [*lines, line("", f"and {more} more changes")] if more else lines


def sign_changes(
    time: Float[np.ndarray, " T"],
    value: Float[np.ndarray, " T"],
    rate: Float[np.ndarray, " T"],
) -> Float[np.ndarray, " n"]:
    """Times at which a sampled function changes its sign.

    Between two samples the function is the cubic that has both values and both rates;
    all its roots count, so that a double change between two samples is found too.

    Args:
        time: Strictly monotonic [s].
        value: Samples.
        rate: Their rates [unit of the samples / s].

    Returns:
        Times in the order of the samples [s], without the first and the last.
    """
    found: list[float] = []
    for k, step in enumerate(np.diff(time)):
        a, b = value[k], value[k + 1]
        c, d = step * rate[k], step * rate[k + 1]
        # the cubic lies between its Bezier points; most intervals end here
        bounds = np.array([a, a + c / 3, b - d / 3, b])
        if np.all(bounds > 0) or np.all(bounds < 0):
            continue
        cubic = np.array([2 * (a - b) + c + d, 3 * (b - a) - 2 * c - d, c, a])
        roots = np.roots(cubic)
        real = np.sort(roots[np.abs(roots.imag) < _CLOSE].real)
        inner = real[(real > -_CLOSE) & (real < 1 + _CLOSE)]
        for root in inner[np.polyval(np.polyder(cubic), inner) != 0]:
            when = time[k] + root * step
            # a sample that is zero is a root of both its intervals
            if not found or abs(when - found[-1]) > 2 * _CLOSE * abs(step):
                found.append(when)
    near_end = _CLOSE * abs(np.diff(time)[[0, -1]])
    changes = np.array(found)
    inside = np.abs(changes - time[0]) > near_end[0]
    return changes[inside & (np.abs(changes - time[-1]) > near_end[1])]


def reversals(
    time: Float[np.ndarray, " T"],
    value: Float[np.ndarray, " T"],
    rate: Float[np.ndarray, " T"],
    least: float,
) -> Float[np.ndarray, " n"]:
    """Times at which a sampled function reverses, other than by a ripple about zero.

    It has reversed once it has gone beyond a least size on either side of zero, one
    after the other; the reversal is its last zero between the two.

    Args:
        time: Strictly monotonic [s].
        value: Samples.
        rate: Their rates [unit of the samples / s].
        least: Size below which no side is taken [unit of the samples].

    Returns:
        Times in the order of the samples [s].
    """
    beyond = np.nonzero(np.abs(value) > least)[0]
    side = np.sign(value[beyond])
    arrived = time[beyond[1:][side[1:] != side[:-1]]]
    if not arrived.size:
        return arrived
    along = np.sign(time[-1] - time[0])
    zeros = sign_changes(time, value, rate)
    before = [int(np.sum(along * zeros < along * t)) for t in arrived]
    return np.array([zeros[count - 1] for count in before if count])


def _spin_lines(
    trajectory: Trajectory, motion: MotionSamples, rows: np.ndarray
) -> list[str]:
    """Spin about the normal and about the body axis next to it, with their reversals.

    The two change sign at different times where the body rocks: Kane and Levinson's
    stone does so in its own omega_3 first.
    """
    spins, rates, upwards = (
        np.asarray(x, dtype=float)[rows] for x in trajectory.each(_spins)
    )
    touches = motion.touches
    axis = int(np.argmax(np.abs(upwards[np.argmax(touches)]))) if touches.any() else 2
    whenever, normal = np.ones_like(touches), "the normal"
    if not touches.all():
        normal += ", while there is a contact"
    known = (3, normal, touches), (axis, f"body axis {'xyz'[axis]}", whenever)
    lines: list[str] = []
    fastest = np.max(np.abs(motion.angular_velocity))
    for k, about, has in known:
        if not has.any():
            continue
        spin = spins[has, k]
        lines.append(
            line("spin", f"{spin[0]:+.6g} -> {spin[-1]:+.6g} rad/s about {about}")
        )
        largest = np.max(np.abs(spin))
        if largest <= _ROUNDING * fastest:
            lines.append(line("  reversals", "none"))
            continue
        # one after the other: what it did in between, in flight, is no reversal
        rests = [slice(on, off + 1) for on, off in spans(has)]
        found = [
            reversals(motion.time[at], spins[at, k], rates[at, k], _SIDE * largest)
            for at in rests
        ]
        times = np.concatenate(found)
        listed = ", ".join(f"{t:.4f}" for t in times[:_MOST_LISTED]) + " s"
        if times.size > _MOST_LISTED:
            listed += f" and {times.size - _MOST_LISTED} more"
        if times.size:
            lines.append(
                line(f"  {times.size} reversal{'s' * (times.size > 1)}", listed)
            )
            lines.append(line("", _WHAT_REVERSES))
        else:
            lines.append(line("  reversals", "none"))
    return lines


def _place_line(motion: MotionSamples) -> str:
    """Where the body's origin was in the end, and how far it had come."""
    start, end = motion.position[0], motion.position[-1]
    at = ", ".join(f"{x:.6g}" for x in end)
    far = f"{np.linalg.norm(end - start):.4g} m from the start"
    return line("end position", f"({at}) m, {far}")


def _energy_line(trajectory: Trajectory, motion: MotionSamples) -> str:
    """Drift of the energy that the motion has to keep; else how it changed."""
    if not motion.kept:
        return work_line(trajectory, motion)
    known = motion.energy_error[np.isfinite(motion.energy_error)]
    if not known.size:
        return line("energy", "is no finite number")
    drift = f"{np.max(known):.1e}"
    if motion.kept == "energy":
        return line("energy drift", drift)
    return line("energy drift", f"{drift} of the moving energy E - w_c . J")


def _force_lines(trajectory: Trajectory, motion: MotionSamples) -> list[str]:
    mass = float(trajectory.scene.body.mass)
    motion = motion.rows(motion.touches)
    if not motion.time.size:
        return [line("normal force", "none, it flies")]
    known = np.isfinite(motion.contact_force).all(axis=1)
    motion = motion.rows(np.flatnonzero(known))
    if not motion.time.size:
        return [line("normal force", "is no finite number")]
    press, time = motion.normal_force, motion.time
    if np.max(np.abs(motion.contact_force)) <= _NO_WEIGHT * mass:
        return [line("normal force", "none")]
    least = int(np.argmin(press))
    lines = [
        line("normal force", f"{press[least]:.4g} N at least, t = {time[least]:.4g} s")
    ]
    pull = float(trajectory.first_pull)
    if trajectory.switches is None and not np.isnan(pull):
        lines.append(
            f"  the contact would have to pull first at t = {pull:.4f} s; the run "
            "assumes that it can"
        )
    pressed = press > 0
    if np.any(pressed):
        tangential = motion.contact_force - press[:, None] * motion.outward
        ratio = np.linalg.norm(tangential, axis=1) / np.where(pressed, press, np.inf)
        most = int(np.argmax(ratio))
        text = f"{ratio[most]:.4g} at most, t = {time[most]:.4g} s"
        if ratio[most] < _NO_FRICTION:
            text = "none"
        if not np.all(pressed):
            text += " (while pressed together)"
        lines.append(line("friction needed", text))
    return lines


def _rolling_lines(motion: MotionSamples, k: int, path: tuple[int, ...]) -> list[str]:
    """Where a body that rolls on or in the body came to, and its normal force."""
    name = "rolling " + ".".join(str(i) for i in path)
    place = motion.rolling_column(k, "position")[-1]
    press = motion.rolling_column(k, "normal_force")[:, 0]
    least = int(np.argmin(press))
    text = f"{press[least]:.4g} N at least, t = {motion.time[least]:.4g} s"
    lines = [
        line(name, f"ends at ({', '.join(f'{x:.4g}' for x in place)}) m"),
        path_line(motion.time, motion.rolling_column(k, "contact_on_carrier")),
        line("  normal force", text),
    ]
    if press[least] < 0.0:
        when = motion.time[np.argmax(press < 0.0)]
        lines.append(
            f"  its contact would have to pull, at the output t = {when:.4g} s first; "
            "the run assumes that it can"
        )
    return lines


def _spins(scene: Scene, t: Array, state: Any) -> tuple[Array, Array, Array]:
    """Spins about the body's axes and the normal, their rates, and the upward normal.

    Returns:
        Spins [rad/s] and rates [rad/s^2], shape (4,) each: x, y, z of the body, then
        the base's normal; the base's normal on body axes [1], shape (3,).
    """

    def spins(t: Array, state: Any) -> tuple[Array, Array]:
        contact = contact_of(scene, t, state)
        upward, w = -contact.normal, contact.angular_velocity
        return jnp.concatenate([w, dot(upward, w)[None]]), upward

    moving = rolling_derivative(scene, t, state)
    along = (jnp.ones_like(t), moving)
    (values, upward), (rates, _) = jax.jvp(spins, (t, state), along)
    return values, rates, upward
