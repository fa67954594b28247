"""Pictures of a study: probabilities, how observables spread, series as fans.

Needs matplotlib, which is imported inside the functions.
"""

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..uncertainty.result import MonteCarlo
from ..validation.checks import FieldError
from .plot_ensemble import quantiles
from .plot_style import BLUE, INK, RED, dress, limits, new_figure, write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PANELS, _ACROSS = 12, 3
_LEVEL = 0.95  # of the intervals that are drawn [1]
# members whose series are drawn: bands of more look the same
_MOST_SERIES = 20_000
_BANDS = ((0.05, 0.95, 0.18), (0.25, 0.75, 0.32))


def figure_study(study: MonteCarlo, title: str = "") -> "Figure":
    """See :meth:`rollkane.MonteCarlo.plot`.

    Args:
        study: What to draw.
        title: Above the figure; plain text.

    Returns:
        A figure that belongs to no window; ``figure.savefig(path)`` writes it.

    Raises:
        ImportError: matplotlib is not installed.
        FieldError: there is nothing to draw, as no motion ended as it should.
    """
    drawn = _panels(study)
    if not drawn:
        remedy = "see why members failed: MonteCarlo.reasons"
        raise FieldError(
            "MonteCarlo.plot", study.reasons, "has nothing to draw", remedy
        )
    across = min(len(drawn), _ACROSS)
    down = -(-len(drawn) // across)
    figure = new_figure((1.0 + 4.0 * across, 0.7 + 2.9 * down))
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for panel, draw in zip(panels, drawn, strict=False):
        draw(panel)
        dress(panel)
    for panel in panels[len(drawn) :]:
        panel.set_visible(False)
    failed = f", {study.failed:,} FAILED" if study.failed else ""
    lines = [*([title] if title else []), f"{study.size:,} members{failed}"]
    figure.suptitle("\n".join(lines), fontsize=11, color=INK, parse_math=False)
    return figure


def plot_study(
    study: MonteCarlo, path: str | os.PathLike[str], title: str = ""
) -> None:
    """Write :func:`figure_study` as a PNG, SVG or PDF file, whole or not at all.

    Args:
        study: What to draw.
        path: Where to; the folder must exist.
        title: Above the figure; plain text.

    Raises:
        ImportError: matplotlib is not installed.
        FieldError: there is nothing to draw.
        OSError: the file cannot be written.
    """
    write_picture(path, figure_study(study, title))


def _panels(study: MonteCarlo) -> list[Callable[["Axes"], None]]:
    """What draws each panel."""
    running = study.statistics
    found: list[Callable[[Axes], None]] = []
    if running.truths and running.count:
        found.append(lambda panel: _probabilities(panel, study))
    counted = {f"{name} count" for name in running.truths}
    for name in running.numbers:
        if name in counted:
            continue
        for place, label in enumerate(running.labels(name)):
            if np.any(study.histogram(label).counts):
                found.append(_histogram_of(study, name, place, label))
    if study.has_members:
        for name, column in study.columns.items():
            if column.kind == "series":
                found += _fans_of(study, name)
    return found[:_MOST_PANELS]


def _probabilities(panel: "Axes", study: MonteCarlo) -> None:
    """A point with its interval for every truth value."""
    rows: list[tuple[str, float, float, float]] = []
    for name in study.statistics.truths:
        low, high = study.interval(name, _LEVEL)
        parts = [np.ravel(x) for x in (study.probability[name], low, high)]
        labels = study.statistics.labels(name)
        rows += [
            (label, float(middle), float(least), float(most))
            for label, middle, least, most in zip(labels, *parts, strict=True)
        ]
    for i, (_, middle, low, high) in enumerate(rows):
        panel.plot([low, high], [i, i], color=BLUE, lw=3.0, alpha=0.4)
        panel.plot([middle], [i], "o", color=BLUE, ms=5.0)
    panel.set_yticks(range(len(rows)), [row[0] for row in rows])
    panel.set_ylim(len(rows) - 0.4, -0.6)
    panel.set_xlim(-0.03, 1.03)
    panel.set_xlabel(f"probability, {100 * _LEVEL:.0f} % interval")


def _histogram_of(
    study: MonteCarlo, name: str, place: int, label: str
) -> Callable[["Axes"], None]:
    def draw(panel: "Axes") -> None:
        counted = study.histogram(label)
        edges, counts = _joined(counted.edges, counted.counts)
        panel.stairs(counts, edges, fill=True, color=BLUE, alpha=0.35)
        low, high = (np.ravel(x)[place] for x in study.interval(name, _LEVEL))
        if np.isfinite(low) and np.isfinite(high):
            panel.axvspan(low, high, color=RED, alpha=0.25, lw=0)
        panel.axvline(np.ravel(study.mean[name])[place], color=RED, lw=1.2)
        some = np.nonzero(counts)[0]
        panel.set_xlim(*limits(edges[[some[0], some[-1] + 1]], 0.03))
        panel.set_xlabel(f"{label}, mean and interval")
        panel.set_ylabel("members")

    return draw


def _joined(edges: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fewer bins where members are few: some twice their number's cube root."""
    wanted = max(8.0, 2.0 * float(counts.sum()) ** (1.0 / 3.0))
    some = np.nonzero(counts)[0]
    together = max(1, int((some[-1] - some[0] + 1) / wanted))
    missing = -len(counts) % together
    step = edges[-1] - edges[-2]
    longer = edges[-1] + step * np.arange(1, missing + 1)
    filled = np.concatenate([counts, np.zeros(missing, counts.dtype)])
    ends = np.concatenate([edges, longer])[::together]
    return ends, filled.reshape(-1, together).sum(axis=1)


def _fans_of(study: MonteCarlo, name: str) -> list[Callable[["Axes"], None]]:
    """A panel for each entry of a series."""
    values = study.values(name)[:_MOST_SERIES]
    values = values.reshape(*values.shape[:2], -1)
    parts = values.shape[2]

    def one(k: int) -> Callable[["Axes"], None]:
        def draw(panel: "Axes") -> None:
            for low, high, opacity in _BANDS:
                bounds = quantiles(values[:, :, k], (low, high))
                panel.fill_between(
                    study.times, *bounds, color=BLUE, alpha=opacity, lw=0
                )
            (middle,) = quantiles(values[:, :, k], (0.5,))
            panel.plot(study.times, middle, color=BLUE, lw=1.4)
            panel.set_xlabel("time [s]: median, 50 and 90 % of members")
            panel.set_ylabel(name if parts == 1 else f"{name}[{k}]")

        return draw

    return [one(k) for k in range(parts)]
