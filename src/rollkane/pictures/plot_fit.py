"""The picture of a fit: what was measured, what is predicted, what is left."""

from collections.abc import Iterator
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..identification import body_sensors, sensors
from ..identification.channels import AbstractChannel
from ..identification.estimates import Estimates
from .plot_style import (
    BLUE,
    BROWN,
    GREEN,
    INK,
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

MOST_RECORDS = 3  # that are drawn, one beside the other
_COLOURS = (BLUE, GREEN, PURPLE, BROWN, RED, INK)
_UNITS: dict[type[AbstractChannel], str] = {
    body_sensors.Gyro: " [rad/s]",
    body_sensors.Accelerometer: " [m/s²]",
    sensors.Position: " [m]",
    sensors.Marker: " [m]",
    sensors.Orientation: " [1]",
    sensors.ContactPath: " [m]",
    sensors.NormalForce: " [N]",
}


class Samples(NamedTuple):
    """A channel of one record beside its prediction.

    Attributes:
        name: Of the channel.
        channel: With its samples.
        time: Of the samples [s], shape (T,).
        predicted: As measured, shape (T, k); NaN where no sample is.
        misfit: Over its deviation [1], shape (T, m).
    """

    name: str
    channel: AbstractChannel
    time: Float[np.ndarray, " T"]
    predicted: Float[np.ndarray, "T k"]
    misfit: Float[np.ndarray, "T m"]


def figure_fit(fit: Estimates, title: str = "") -> "Figure":
    """Samples (dots) and prediction (lines) by channel, and misfits below them.

    Misfits are over their standard deviation, with a band of two. Of several records
    the first three are drawn.

    Args:
        fit: What was found.
        title: Above the figure; plain text.

    Returns:
        A figure that belongs to no window; ``figure.savefig(path)`` writes it.

    Raises:
        ImportError: matplotlib is not installed.
    """
    problem = fit.problem
    shown = min(len(problem.records), MOST_RECORDS)
    records = [list(_samples(fit, number)) for number in range(shown)]
    rows = max(len(record) for record in records)
    figure = new_figure((max(8.0, 5.0 * shown), 3.4 * rows + 0.3))
    axes = figure.subplots(
        2 * rows,
        shown,
        squeeze=False,
        sharex="col",
        gridspec_kw={"height_ratios": [2.4, 1.0] * rows},
    )
    for number, record in enumerate(records):
        for row in range(rows):
            pair = axes[2 * row, number], axes[2 * row + 1, number]
            if row < len(record):
                _draw(*pair, record[row])
            else:
                for panel in pair:
                    panel.set_visible(False)
        last = axes[2 * len(record) - 1, number]
        last.set_xlabel("time [s]")
        last.tick_params(labelbottom=True)
        if shown > 1:
            axes[0, number].set_title(f"record {number}", color=INK, fontsize=10)
    for number in range(shown):
        figure.align_ylabels(axes[:, number])
    figure.suptitle(_head(fit, title, shown), color=INK, fontsize=11)
    return figure


def plot_fit(fit: Estimates, path: str | PathLike[str], title: str = "") -> None:
    """Write the picture as a PNG, SVG or PDF file.

    Args:
        fit: What was found.
        path: File to write, whole or not at all.
        title: Above the figure.

    Raises:
        ImportError: matplotlib is not installed.
    """
    write_picture(path, figure_fit(fit, title))


def _samples(fit: Estimates, number: int) -> Iterator[Samples]:
    """A record's channels in its order."""
    problem = fit.problem
    misfits = problem.channel_misfits(fit.search.minimum.z, reached=True)[number]
    held = {
        name: (channel, np.asarray(group.time))
        for group in problem.groups[number]
        for name, channel in group.channels.items()
    }
    for name in problem.records[number].channels:
        channel, time = held[name]
        left = misfits[name] * np.asarray(channel.sigma)
        yield Samples(name, channel, time, channel.without(left), misfits[name])


def _draw(upper: "Axes", lower: "Axes", samples: Samples) -> None:
    values = np.asarray(samples.channel.values)
    size = 2.5 if len(values) <= 2000 else 1.2
    labels = _labels(samples.channel, values.shape[1])
    for k, label in enumerate(labels):
        colour = _COLOURS[k % len(_COLOURS)]
        upper.plot(
            samples.time, values[:, k], ".", color=colour, markersize=size, alpha=0.55
        )
        line = samples.predicted[:, k]
        upper.plot(samples.time, line, "-", color=colour, linewidth=1.0, label=label)
    # rotations about x, y and z of a quaternion have the colours of its vector part
    first: int = values.shape[1] - samples.misfit.shape[1]
    for k in range(int(samples.misfit.shape[1])):
        colour = _COLOURS[(k + first) % len(_COLOURS)]
        misfit = samples.misfit[:, k]
        lower.plot(samples.time, misfit, ".", color=colour, markersize=size, alpha=0.7)
    lower.axhspan(-2.0, 2.0, color="#eceff3", zorder=0)
    most = np.nanmax(np.abs(samples.misfit), initial=3.0)
    lower.set_ylim(-1.08 * most, 1.08 * most)
    upper.set_ylabel(samples.name + _unit(samples.channel))
    lower.set_ylabel("misfit / σ")
    for panel in (upper, lower):
        dress(panel)
        panel.set_xlim(*limits(samples.time, 0.02))
    if len(labels) > 1:
        upper.legend(fontsize=8, frameon=False, ncols=len(labels), loc="upper right")
        low, high = upper.get_ylim()
        upper.set_ylim(low, high + 0.12 * (high - low))  # room for it


def _labels(channel: AbstractChannel, count: int) -> tuple[str, ...]:
    if isinstance(channel, sensors.Orientation):
        return "w", "x", "y", "z"
    if isinstance(channel, sensors.Observed):
        return tuple(str(k) for k in range(count))
    return ("x", "y", "z")[:count]


def _unit(channel: AbstractChannel) -> str:
    return _UNITS.get(type(channel), "")


def _head(fit: Estimates, title: str, shown: int) -> str:
    good = f"χ²/ν = {fit.chi2 / max(fit.degrees_of_freedom, 1):.3g}"
    count = len(fit.problem.records)
    some = f"{shown} of {count} records" if shown < count else ""
    settled = "" if fit.converged else "NOT converged"
    parts: list[Any] = [title, good, settled, some]
    return ", ".join(part for part in parts if part)
