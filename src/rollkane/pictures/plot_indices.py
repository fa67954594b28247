"""Pictures of what decides, what can be told, and what is rare.

Needs matplotlib, which is imported inside the functions.
"""

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from ..identification.experiment_design import ExperimentDesign
from ..identification.identifiability import Identifiability
from ..uncertainty.active_directions import ActiveDirections
from ..uncertainty.rare_event import RareEvent
from ..uncertainty.sobol_result import SobolIndices
from .plot_style import BLUE, BROWN, INK, RED, dress, given, limits, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Target = str | os.PathLike[str] | None
_MOST_PANELS = 6
_TO_ZERO = 1 - 1e-9  # an error bar on a logarithmic axis ends just above zero


def plot_sobol(
    found: SobolIndices, path: Target = None, title: str = ""
) -> "Figure | None":
    """First-order and total indices with their intervals: a panel for each number.

    Args:
        found: The indices; the first six numbers of the outputs are drawn.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    drawn = _numbers(found)[:_MOST_PANELS]
    count = max(len(drawn), 1)
    figure = new_figure((7.5, 0.8 + 2.5 * count))
    panels: Any = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    places = np.arange(len(found.names))
    for panel, (label, first, total) in zip(panels, drawn, strict=False):
        kinds = (
            (-0.18, first, BLUE, "", "first order"),
            (0.18, total, BROWN, "//", "total"),
        )
        for shift, (index, (low, high)), color, hatch, name in kinds:
            spread = np.stack([np.maximum(index - low, 0), np.maximum(high - index, 0)])
            how: Any = {"width": 0.34, "color": color, "hatch": hatch, "label": name}
            how |= {"error_kw": {"ecolor": INK, "capsize": 3, "lw": 1.0}}
            how |= {"edgecolor": "white", "lw": 0.0}
            panel.bar(places + shift, index, yerr=spread, **how)
        panel.axhline(0.0, color=INK, lw=0.8)
        panel.set_ylabel(f"index of {label} [1]")
        dress(panel)
    panels[0].legend(fontsize=8, frameon=False, ncols=2)
    panels[-1].set_xticks(places, found.names)
    return given(figure, path, title)


def _numbers(found: SobolIndices) -> list[tuple[str, Any, Any]]:
    """Each number of each output: its name, and both indices with their intervals."""
    drawn: list[tuple[str, Any, Any]] = []
    for name, first in found.first.items():
        count = len(found.names)
        parts = first.reshape(count, -1)
        total = found.total[name].reshape(count, -1)
        ends = found.first_interval[name].reshape(2, count, -1)
        total_ends = found.total_interval[name].reshape(2, count, -1)
        for k in range(parts.shape[1]):
            label = name if parts.shape[1] == 1 else f"{name}[{k}]"
            one = parts[:, k], ends[:, :, k]
            drawn.append((label, one, (total[:, k], total_ends[:, :, k])))
    return drawn


def plot_active_directions(
    found: ActiveDirections, path: Target = None, title: str = ""
) -> "Figure | None":
    """Eigenvalues with their intervals, and each factor's share of their sum.

    Args:
        found: The directions.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure = new_figure((9.0, 4.0))
    left, right = figure.subplots(1, 2)
    values, (low, high) = found.eigenvalues, found.eigenvalue_interval
    # rounding of the largest: below it, what is zero on the logarithmic axis
    floor = 1e-16 * max(float(np.max(values, initial=0.0)), 1e-300)
    values = np.maximum(values, floor)
    numbers = np.arange(1, len(values) + 1)
    spread = np.stack([np.maximum(values - low, 0), np.maximum(high - values, 0)])
    spread[0] = np.minimum(spread[0], values * _TO_ZERO)
    how: Any = {"fmt": "o", "color": BLUE, "ms": 4, "capsize": 3, "lw": 1.0}
    left.errorbar(numbers, values, yerr=spread, **how)
    left.set_yscale("log")
    left.set_xticks(numbers)
    left.set_xlabel("direction")
    left.set_ylabel(f"eigenvalue, of {found.of}")
    places = np.arange(len(found.factors))
    right.bar(places, found.activity, width=0.6, color=BLUE)
    right.set_xticks(places, found.factors, rotation=30, ha="right")
    right.set_ylabel("activity score")
    for panel in (left, right):
        dress(panel)
    return given(figure, path, title)


def plot_rare_event(
    found: RareEvent, path: Target = None, title: str = ""
) -> "Figure | None":
    """Thresholds of subset simulation against the probability to reach them.

    Args:
        found: The event.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure = new_figure((6.5, 4.6))
    panel = figure.add_subplot()
    thresholds = np.array([level.threshold for level in found.levels])
    reached = np.cumprod([level.probability for level in found.levels])
    errors = reached * np.array([level.relative_error for level in found.levels])
    how: Any = {"color": BLUE, "ms": 4, "capsize": 3, "lw": 1.0, "fmt": "o-"}
    below = np.minimum(errors, reached * _TO_ZERO)
    panel.errorbar(
        thresholds, reached, yerr=[below, errors], label="levels, first run", **how
    )
    panel.axvline(found.threshold, color=RED, lw=0.9, linestyle="--", label="the event")
    if found.probability > 0:
        low, high = found.interval
        ends = [[found.probability - low], [high - found.probability]]
        how = {"color": RED, "fmt": "s", "ms": 5, "capsize": 3}
        label = f"{found.probability:.3g}, by {found.method}"
        panel.errorbar(
            [found.threshold], [found.probability], yerr=ends, label=label, **how
        )
    panel.set_yscale("log")
    panel.set_xlim(*limits(np.append(thresholds, found.threshold), 0.1))
    if found.below:
        panel.invert_xaxis()
    panel.set_xlabel(found.of)
    panel.set_ylabel("probability to reach it [1]")
    panel.legend(fontsize=8, frameon=False)
    dress(panel)
    return given(figure, path, title)


def plot_identifiability(
    found: Identifiability, path: Target = None, title: str = ""
) -> "Figure | None":
    """Singular values, over the noise: below one a direction is lost in it.

    Args:
        found: What a record can tell.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure = new_figure((6.5, 4.2))
    panel = figure.add_subplot()
    values = np.asarray(found.singular_values, float)
    # a tenth of rounding of the largest, or of what is measured as well as it is known
    floor = 1e-17 * max(float(np.max(values, initial=0.0)), 1.0)
    numbers = np.arange(1, len(values) + 1)
    how: Any = {"color": BLUE, "marker": "o", "linestyle": "none", "ms": 5}
    panel.plot(numbers, np.maximum(values, floor), **how)
    panel.axhline(1.0, color=RED, lw=0.9, linestyle="--")
    how = {"color": RED, "fontsize": 8, "ha": "right", "va": "bottom"}
    panel.text(
        0.99, 1.1, "known to 100 %", transform=panel.get_yaxis_transform(), **how
    )
    panel.set_yscale("log")
    panel.set_xticks(numbers)
    panel.set_xlabel(f"direction among {', '.join(found.names)}"[:90])
    panel.set_ylabel("singular value over the noise [1]")
    dress(panel)
    return given(figure, path, title)


def plot_design(
    found: ExperimentDesign, path: Target = None, title: str = ""
) -> "Figure | None":
    """Scores of the candidates [nat], and that of the design.

    Args:
        found: The design.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure = new_figure((6.5, 4.2))
    panel = figure.add_subplot()
    scores = np.asarray(found.scores, float)
    numbers = np.arange(len(scores))
    seen = np.isfinite(scores)
    how: Any = {"linestyle": "none", "ms": 4}
    panel.plot(numbers[seen], scores[seen], "o", color=BLUE, label="candidates", **how)
    panel.plot([found.best], [found.score], "s", color=RED, label="the design", **how)
    low = limits(np.append(scores[seen], found.score), 0.1)
    panel.set_ylim(*low)
    if not seen.all():
        blind = np.full(int((~seen).sum()), low[0])
        label = "candidates that do not see all"
        panel.plot(numbers[~seen], blind, "x", color=INK, label=label, **how)
    panel.set_xlabel("number of the candidate")
    panel.set_ylabel("score [nat]")
    panel.legend(fontsize=8, frameon=False)
    dress(panel)
    return given(figure, path, title)
