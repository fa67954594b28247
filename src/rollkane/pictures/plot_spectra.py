"""Pictures of stability: eigenvalues, Floquet multipliers, exponents, modes.

Needs matplotlib, which is imported inside the functions.
"""

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from ..stability.linear_model import LinearModel
from ..stability.lyapunov import LyapunovSpectrum
from ..stability.normal_modes import NormalModes
from ..stability.periodic import PeriodicMotion
from ..stability.periodic_family import PeriodicFamily
from ..stability.steady import SteadyMotion
from .plot_style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    LINES,
    RED,
    dress,
    given,
    limits,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Target = str | os.PathLike[str] | None


def plot_steady(
    motion: SteadyMotion, path: Target = None, title: str = ""
) -> "Figure | None":
    """Eigenvalues of a steady motion in the complex plane [1/s].

    Args:
        motion: The motion.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure, panel = _plane()
    _points(
        panel, np.asarray(motion.eigenvalues), "eigenvalues", np.asarray(motion.errors)
    )
    zeros = np.array(list(motion.zeros.values()), complex)
    _crosses(panel, zeros, "of symmetries and the family")
    _finish_plane(panel, motion.eigenvalues)
    said = "stable to first order" if motion.stable else "unstable"
    return given(figure, path, _headed(title, said))


def plot_linear_model(
    model: LinearModel, path: Target = None, title: str = ""
) -> "Figure | None":
    """Eigenvalues of a linear model in the complex plane [1/s].

    Args:
        model: The model.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure, panel = _plane()
    eigenvalues = np.linalg.eigvals(np.asarray(model.A))
    _points(panel, eigenvalues, "eigenvalues of A", None)
    _finish_plane(panel, eigenvalues)
    return given(figure, path, title)


def plot_periodic(
    motion: PeriodicMotion, path: Target = None, title: str = ""
) -> "Figure | None":
    """Floquet multipliers in the complex plane, with the unit circle [1].

    Args:
        motion: The motion.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure, panel = _plane(unit="")
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    panel.plot(np.cos(angle), np.sin(angle), color=FAINT, lw=1.2, zorder=0.6)
    multipliers = np.asarray(motion.multipliers)
    _points(panel, multipliers, "multipliers", np.asarray(motion.uncertain))
    _crosses(panel, np.asarray(motion.expected_multipliers), "expected")
    most = 1.1 * max(1.05, float(np.max(np.abs(multipliers), initial=1.0)))
    panel.set(xlim=(-most, most), ylim=(-most, most))
    panel.set_aspect("equal")
    panel.legend(fontsize=8, frameon=False, loc="upper left")
    said = "stable to first order" if motion.stable else "unstable"
    return given(figure, path, _headed(title, f"period {motion.period:.6g} s, {said}"))


def plot_periodic_family(
    family: PeriodicFamily, path: Target = None, title: str = ""
) -> "Figure | None":
    """Periods and largest multipliers against what is varied.

    Args:
        family: The family.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure = new_figure((7.0, 5.6))
    panels: Any = figure.subplots(2, 1, sharex=True)
    largest = [np.max(np.abs(p.multipliers), initial=1.0) for p in family.points]
    rows = (
        (family.periods, "period [s]"),
        (np.array(largest), "largest |multiplier| [1]"),
    )
    stable = family.stable
    for panel, (y, label) in zip(panels, rows, strict=True):
        panel.plot(family.values, y, color=FAINT, lw=1.0, zorder=0.8)
        for flags, color, marker, name in (
            (stable, BLUE, "o", "stable"),
            (~stable, RED, "x", "unstable"),
        ):
            how: Any = {"color": color, "marker": marker, "linestyle": "none", "ms": 4}
            panel.plot(family.values[flags], y[flags], label=name, **how)
        for critical in family.critical:
            panel.axvline(critical.value, color=INK, lw=0.8, linestyle=":")
        panel.set_ylim(*limits(y, 0.08, 1e-6))
        panel.set_ylabel(label)
        dress(panel)
    panels[0].legend(fontsize=8, frameon=False)
    panels[-1].set_xlabel(family.vary)
    figure.align_ylabels(panels)
    return given(figure, path, title)


def plot_lyapunov(
    found: LyapunovSpectrum, path: Target = None, title: str = ""
) -> "Figure | None":
    """Growth against time, whose slopes are the exponents, and the exponents [1/s].

    Args:
        found: The spectrum.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure = new_figure((10.0, 4.2))
    growth, bars = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    for k, column in enumerate(np.asarray(found.growth).T):
        color, dashes = LINES[k % len(LINES)]
        how: Any = {"color": color, "linestyle": dashes, "lw": 1.2}
        growth.plot(found.time, column, label=f"{k + 1}", **how)
    growth.set_xlabel("time [s]")
    growth.set_ylabel("logarithm of growth [1]")
    growth.legend(
        fontsize=8, frameon=False, ncols=2, title="exponent", title_fontsize=8
    )
    numbers = np.arange(1, len(found.values) + 1)
    how = {"fmt": "o", "color": BLUE, "ms": 4, "capsize": 3, "lw": 1.0}
    bars.errorbar(numbers, found.values, yerr=found.errors, **how)
    bars.axhline(0.0, color=INK, lw=0.8)
    bars.set_xticks(numbers)
    bars.set_xlabel("exponent")
    bars.set_ylabel("value [1/s]")
    for panel in (growth, bars):
        dress(panel)
    return given(figure, path, title)


def plot_normal_modes(
    modes: NormalModes, path: Target = None, title: str = ""
) -> "Figure | None":
    """A panel for each mode: its frequency [Hz] and its shape.

    Args:
        modes: The modes; the first six are drawn.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    count = min(max(len(modes.frequencies), 1), 6)
    figure = new_figure((7.5, 0.9 + 1.5 * count))
    panels: Any = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    places = np.arange(len(modes.coordinates))
    for panel, frequency, shape in zip(
        panels, modes.frequencies, modes.shapes, strict=False
    ):
        panel.bar(places, shape, width=0.6, color=BLUE)
        panel.axhline(0.0, color=INK, lw=0.8)
        # velocities of one that turns nowhere may be above its largest place, one
        high = 1.15 * float(np.max(np.abs(shape), initial=1.0))
        panel.set_ylim(-high, high)
        panel.set_ylabel("shape [1]")
        told = f"{frequency:.4g} rad/s, {frequency / (2.0 * np.pi):.4g} Hz"
        panel.set_title(told, fontsize=9, loc="left", color=INK)
        dress(panel)
    panels[-1].set_xticks(places, modes.coordinates, rotation=30, ha="right")
    return given(figure, path, title)


def _plane(unit: str = " [1/s]") -> "tuple[Figure, Axes]":
    """An empty complex plane."""
    figure = new_figure((6.0, 5.0))
    panel = figure.add_subplot()
    panel.axhline(0.0, color=FAINT, lw=0.8)
    panel.axvline(0.0, color=INK, lw=0.9)
    panel.set_xlabel(f"real part{unit}")
    panel.set_ylabel(f"imaginary part{unit}")
    dress(panel)
    return figure, panel


def _points(
    panel: "Axes", values: np.ndarray, label: str, errors: np.ndarray | None
) -> None:
    how: Any = {"fmt": "o", "color": BLUE, "ms": 5, "lw": 1.0, "label": label}
    panel.errorbar(np.real(values), np.imag(values), xerr=errors, **how)


def _crosses(panel: "Axes", values: np.ndarray, label: str) -> None:
    if values.size:
        how: Any = {"marker": "x", "color": GREEN, "linestyle": "none", "label": label}
        panel.plot(np.real(values), np.imag(values), **how)


def _finish_plane(panel: "Axes", eigenvalues: np.ndarray) -> None:
    """Ranges with room, and the side where motions grow."""
    most = float(np.max(np.abs(eigenvalues), initial=1e-9))
    wide = 1.3 * max(
        float(np.max(np.abs(np.real(eigenvalues)), initial=0.0)), 0.05 * most
    )
    high = 1.2 * max(
        float(np.max(np.abs(np.imag(eigenvalues)), initial=0.0)), 0.05 * most
    )
    panel.set(xlim=(-wide, wide), ylim=(-high, high))
    panel.axvspan(0.0, wide, color=RED, alpha=0.06, lw=0)
    how: Any = {"ha": "right", "fontsize": 8, "color": RED}
    panel.text(0.99, 0.02, "grows", transform=panel.transAxes, **how)
    panel.legend(fontsize=8, frameon=False, loc="upper left")


def _headed(title: str, said: str) -> str:
    return f"{title}: {said}" if title else said
