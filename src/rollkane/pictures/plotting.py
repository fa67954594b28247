"""Pictures of a trajectory: the motion against time, and the path of the contact.

Needs matplotlib, which is imported inside the functions; its object interface is used
throughout, so that no global state of the caller's program changes.
"""

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.surfaces import (
    AbstractSurface,
    Cone,
    Cylinder,
    DiscEdge,
    Revolution,
    Ring,
    Torus,
)
from ..simulation.trajectory import Trajectory
from .envelopes import draw_curve
from .mesh import body_size
from .motion_samples import MotionSamples, motion_samples, spans
from .plot_path import draw_path, draw_path_in_space
from .plot_style import (
    BLUE,
    BROWN,
    FAINT,
    GREEN,
    INK,
    LINES,
    PURPLE,
    RED,
    dress,
    limits,
    new_figure,
    write_picture,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FACES_UP = 0.5  # least z of the base's normals in a picture from above [1]
_INDEX = "₁₂₃₄₅₆₇₈₉₀"
_ROUND_BODIES = (Cone, Cylinder, DiscEdge, Revolution, Ring, Torus)


def figure_overview(trajectory: Trajectory, title: str = "") -> "Figure":
    """Spin, tilt, energy, normal force and what is carried, against time.

    Spin is the angular velocity along the base's outward normal at the contact
    [rad/s]. Tilt is the angle between that normal and an axis of the body [deg]: the
    axis of symmetry of a round body, else the one that was nearest to the normal at
    the start. In flight, without a contact, neither is drawn. The energy is shown by
    its error ``|E - E0| / |E0|`` [1] (on a steady turntable that of the moving energy);
    where the base or forces inside do work, as it is [J]. The normal force [N] is
    shaded where the contact would have to pull. Where something is carried, its
    coordinates alpha come last.

    Args:
        trajectory: One run, not a batch; what it did not reach is left blank.
        title: Written above; plain text.

    Returns:
        A figure that belongs to no window; ``figure.savefig(path)`` writes it.

    Raises:
        ImportError: matplotlib is not installed.
        FieldError: a batch.
    """
    motion = motion_samples(trajectory)
    panels = 4 + bool(motion.alpha.shape[1])
    figure = new_figure((8.0, 2.0 * panels))
    axes = figure.subplots(panels, 1, sharex=True)
    _draw_spin(axes[0], motion)
    _draw_tilt(axes[1], motion, isinstance(_body(trajectory), _ROUND_BODIES))
    _draw_energy(axes[2], motion)
    _draw_normal_force(axes[3], motion, trajectory)
    if panels > 4:
        _draw_alpha(axes[4], motion)
    for panel in axes:
        dress(panel)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(*limits(motion.time, 0.0))
    figure.align_ylabels(axes)
    _head(figure, trajectory, title)
    return figure


def figure_contact_path(trajectory: Trajectory, title: str = "") -> "Figure":
    """Path of the contact point on the base, coloured by time; dotted, flights.

    Seen from above (x and y, equal scales) where the base faces upwards all along the
    path; in space on any other. Beside the path on a base that moves stands that in
    fixed axes.

    Args:
        trajectory: One run, not a batch.
        title: Written above; plain text.

    Returns:
        A figure that belongs to no window; ``figure.savefig(path)`` writes it.

    Raises:
        ImportError: matplotlib is not installed.
        FieldError: a batch.
    """
    figure = new_figure((7.0, 6.0))
    motion = motion_samples(trajectory)
    base = trajectory.scene.base.surface
    upwards = motion.base_outward[motion.touches, 2]
    if base.is_height or (upwards > _FACES_UP).all():
        _from_above(figure, motion, base)
    else:
        panel = figure.add_subplot(projection="3d")
        touched = motion.contact_on_body[motion.reached]
        size = body_size(trajectory.scene.body, touched)
        draw_path_in_space(panel, motion, base, size)
    _head(figure, trajectory, title)
    return figure


def plot_overview(
    trajectory: Trajectory, path: str | os.PathLike[str], title: str = ""
) -> None:
    """Write :func:`figure_overview` as a PNG, SVG or PDF file, whole or not at all.

    Args:
        trajectory: One run, not a batch.
        path: Where to; the folder must exist.
        title: Written above; plain text.

    Raises:
        ImportError: matplotlib is not installed.
        FieldError: a batch.
        OSError: the file cannot be written.
    """
    write_picture(path, figure_overview(trajectory, title))


def plot_contact_path(
    trajectory: Trajectory, path: str | os.PathLike[str], title: str = ""
) -> None:
    """Write :func:`figure_contact_path` as a PNG, SVG or PDF file, whole or not at all.

    Args:
        trajectory: One run, not a batch.
        path: Where to; the folder must exist.
        title: Written above; plain text.

    Raises:
        ImportError: matplotlib is not installed.
        FieldError: a batch.
        OSError: the file cannot be written.
    """
    write_picture(path, figure_contact_path(trajectory, title))


def _from_above(figure: "Figure", motion: MotionSamples, base: AbstractSurface) -> None:
    """The path from above; of a base that moves, on it and in fixed axes."""
    if not motion.base_moves:
        figure.set_size_inches(*_shape(motion.contact_on_base[motion.reached, :2]))
        draw_path(figure.add_subplot(), motion, base)
        return
    shapes = [
        _shape(path[motion.reached, :2])
        for path in (motion.contact_on_base, motion.contact)
    ]
    figure.set_size_inches(12.5, max(height for _, height in shapes))
    on_base, in_space = figure.subplots(1, 2)
    draw_path(on_base, motion, base, colorbar=False)
    on_base.set_title("on the base", fontsize=10, color=INK)
    draw_path(in_space, motion, in_space=True)
    in_space.set_title("in fixed axes", fontsize=10, color=INK)


def _shape(path: np.ndarray) -> tuple[float, float]:
    """Width and height [in] of a picture that a path seen from above fills well."""
    wide, high = np.ptp(path, axis=0) if len(path) else (1.0, 1.0)
    ratio = high / wide if wide > 0 else 1.0
    return 7.0, 1.0 + 5.0 * float(np.clip(ratio, 0.35, 1.2))


def _body(trajectory: Trajectory):
    return trajectory.scene.body.surface


def _head(figure: "Figure", trajectory: Trajectory, title: str) -> None:
    """Title, and below it why the run ended early if it did."""
    lines = [title] if title else []
    if not bool(trajectory.succeeded):
        reason = trajectory.reason.split(":")[0]
        lines.append(f"stopped at {float(trajectory.final_time):.6g} s: {reason}")
    if lines:
        figure.suptitle("\n".join(lines), fontsize=12, color=INK, parse_math=False)


def _curve(
    panel: "Axes",
    motion: MotionSamples,
    values: np.ndarray,
    color: str,
    label: str = "",
    dashes: Any = "-",
) -> None:
    """A line through the finite values; a lone one is shown as a point."""
    finite = np.isfinite(values)
    shown = np.where(finite, values, np.nan)
    draw_curve(panel, motion.time, shown, color, label, dashes)
    if finite.sum() < 3:
        panel.plot(motion.time[finite], values[finite], "o", color=color, ms=4)
    if not finite.any():
        why = "no contact" if motion.reached.any() else "not reached"
        panel.text(0.5, 0.5, why, transform=panel.transAxes, ha="center")


def _draw_spin(panel: "Axes", motion: MotionSamples) -> None:
    _curve(panel, motion, motion.spin, BLUE)
    panel.set_ylim(*limits(motion.spin, 0.08, 1e-3))
    low, high = panel.get_ylim()
    if low < 0 < high:
        panel.axhline(0.0, color=FAINT, lw=1.0, zorder=0.5)
    panel.set_ylabel("spin [rad/s]")


def _draw_tilt(panel: "Axes", motion: MotionSamples, round_body: bool) -> None:
    tilt, axis = tilt_angle(motion, round_body)
    _curve(panel, motion, tilt, GREEN)
    panel.set_ylim(*limits(tilt, 0.08, 1e-3))
    panel.set_ylabel(f"tilt of body {axis} [deg]")


def tilt_angle(motion: MotionSamples, round_body: bool) -> tuple[np.ndarray, str]:
    """Angle between an axis of the body and the base's normal.

    Args:
        motion: The motion, with times that it did not reach.
        round_body: Take the z axis; else the axis nearest to the normal at the start.

    Returns:
        Angles [deg], shape (T,), NaN in flight, and the axis' name with its sense.
    """
    a, b, c, d = motion.orientation.T
    axes = np.array(  # body axes in fixed components, (axis, component, T)
        [
            [1 - 2 * (c * c + d * d), 2 * (b * c + a * d), 2 * (b * d - a * c)],
            [2 * (b * c - a * d), 1 - 2 * (b * b + d * d), 2 * (c * d + a * b)],
            [2 * (b * d + a * c), 2 * (c * d - a * b), 1 - 2 * (b * b + c * c)],
        ]
    )
    along = np.einsum("kit,ti->kt", axes, motion.outward)
    touches = motion.touches
    start = along[:, np.argmax(touches)]
    k = 2 if round_body or not touches.any() else int(np.argmax(np.abs(start)))
    sign = -1.0 if start[k] < 0 else 1.0
    across = np.linalg.norm(np.cross(axes[k].T, motion.outward), axis=1)
    angle = np.degrees(np.arctan2(across, sign * along[k]))
    return np.where(touches, angle, np.nan), "−" * (sign < 0) + "xyz"[k]


def _draw_alpha(panel: "Axes", motion: MotionSamples) -> None:
    count = motion.alpha.shape[1]
    for k, values in enumerate(motion.alpha.T):
        color, dashes = LINES[k % len(LINES)]
        _curve(panel, motion, values, color, f"α{_INDEX[k % 10]}", dashes)
    panel.set_ylim(*limits(motion.alpha, 0.08, 1e-6))
    panel.set_ylabel("carried: α [m or rad]")
    if count > 1:
        panel.legend(loc="upper right", ncols=min(count, 6), fontsize=8, frameon=False)


def _draw_energy(panel: "Axes", motion: MotionSamples) -> None:
    if not motion.kept:
        _curve(panel, motion, motion.energy, PURPLE)
        panel.set_ylim(*limits(motion.energy, 0.08, 1e-12))
        panel.set_ylabel("energy [J]")
        return
    floor = 0.5 * motion.rounding
    error = np.maximum(motion.energy_error, floor)  # zero has no logarithm
    _curve(panel, motion, error, PURPLE)
    top = np.max(error[np.isfinite(error)], initial=floor)
    panel.set_yscale("log")
    bottom = 0.05 * floor  # room for the words below the lowest values
    panel.set_ylim(bottom, max(4.0 * top, 100 * motion.rounding))
    panel.axhspan(bottom, 2 * floor, color=FAINT, alpha=0.35, lw=0)
    panel.text(
        0.995,
        1.5 * bottom,
        "rounding of one number",
        transform=panel.get_yaxis_transform(),
        ha="right",
        va="bottom",
        fontsize=8,
        color=INK,
    )
    letter = "E" if motion.kept == "energy" else "E*"
    panel.set_ylabel(f"|{letter} − {letter}₀| / |{letter}₀| [1]")
    if letter == "E*":
        panel.set_title("E*: moving energy", loc="right", fontsize=9, pad=3)


def _draw_normal_force(
    panel: "Axes", motion: MotionSamples, trajectory: Trajectory
) -> None:
    force = motion.normal_force
    _curve(panel, motion, force, BROWN)
    low, high = limits(np.append(force, 0.0), 0.06)
    panel.set_ylim(low, high)
    panel.axhline(0.0, color=INK, lw=0.8)
    pulls = force < 0
    if pulls.any():
        panel.fill_between(motion.time, force, 0.0, where=pulls, color=RED, alpha=0.3)
        for on, off in spans(pulls):
            panel.axvspan(motion.time[on], motion.time[off], color=RED, alpha=0.08)
        does = "pulls" if trajectory.switches is None else "lost"
        when = float(trajectory.first_pull)
        if np.isfinite(when):  # a contact that may pull is never lost
            first = f"{does} first at {when:.6g} s"
            panel.set_title(first, loc="right", color=RED, fontsize=9, pad=3)
    panel.set_ylabel("normal force [N]")
