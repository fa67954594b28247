"""Pictures of an ensemble: how its members spread, and how and where they end.

Needs matplotlib, which is imported inside the functions.
"""

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..files.export import QUANTITIES
from ..simulation.ensemble_result import Ensemble
from ..validation.checks import FieldError
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

_COLOURS = (BLUE, RED, GREEN, PURPLE, BROWN, INK)
_COMPONENTS = {"axis": "xyz", "quaternion": "wxyz"}
# bands of the members, from the widest: lowest and highest share, opacity
_BANDS = ((0.05, 0.95, 0.18), (0.25, 0.75, 0.32))
_MOST_PANELS, _MOST_BINS = 6, 60


class Shown(NamedTuple):
    """Numbers of every member.

    Attributes:
        values: Shape (N, T, k) of a motion, (N, k) of its ends.
        labels: Of each of the k numbers, with units.
        units: Of all of them.
    """

    values: np.ndarray
    labels: tuple[str, ...]
    units: str


def figure_ensemble(
    ensemble: Ensemble,
    of: str | Callable[..., Any] = "position",
    kind: str = "fan",
    title: str = "",
) -> "Figure":
    """See :meth:`rollkane.Ensemble.plot`.

    Args:
        ensemble: What to draw.
        of: A quantity by its name, something observed, or a function.
        kind: ``"fan"``, ``"histogram"`` or ``"scatter"``.
        title: Above the figure; plain text.

    Returns:
        A figure that belongs to no window; ``figure.savefig(path)`` writes it.

    Raises:
        ImportError: matplotlib is not installed.
        FieldError: no such quantity or kind, or states that were not kept.
    """
    drawn = {"fan": _fan, "histogram": _histograms, "scatter": _scatter}
    if kind not in drawn:
        known = f"use one of {tuple(drawn)}"
        raise FieldError("Ensemble.plot.kind", kind, "is not known", known)
    figure = drawn[kind](ensemble, shown(ensemble, of, at_end=kind != "fan"))
    outcomes = _outcomes(ensemble)
    counts = ", ".join(f"{np.sum(flags):,} {name}" for name, flags in outcomes.items())
    alone = f"{len(ensemble.code):,} members, {next(iter(outcomes))}"
    below = [counts if len(outcomes) > 1 else alone]
    if kind != "fan" and len(outcomes) > 1:
        below = []  # the legend says it
    lines = ([title] if title else []) + below
    if lines:
        figure.suptitle("\n".join(lines), fontsize=11, color=INK, parse_math=False)
    return figure


def plot_ensemble(
    ensemble: Ensemble,
    path: str | os.PathLike[str],
    of: str | Callable[..., Any] = "position",
    kind: str = "fan",
    title: str = "",
) -> None:
    """Write :func:`figure_ensemble` as a PNG, SVG or PDF file, whole or not at all.

    Args:
        ensemble: What to draw.
        path: Where to; the folder must exist.
        of: A quantity by its name, something observed, or a function.
        kind: ``"fan"``, ``"histogram"`` or ``"scatter"``.
        title: Above the figure; plain text.

    Raises:
        ImportError: matplotlib is not installed.
        FieldError: no such quantity or kind, or states that were not kept.
        OSError: the file cannot be written.
    """
    write_picture(path, figure_ensemble(ensemble, of, kind, title))


def shown(ensemble: Ensemble, of: str | Callable[..., Any], at_end: bool) -> Shown:
    """Numbers of a quantity.

    Args:
        ensemble: Whose they are.
        of: A quantity by its name, something observed, or a function.
        at_end: Of each member's end; of what was observed, at the last output.

    Raises:
        FieldError: no such quantity, or states that were not kept.
    """
    observed = ensemble.observed_by_name
    motion = ensemble.final if at_end else ensemble
    units, axes = "", ""
    if callable(of):
        name, values = getattr(of, "__name__", ""), motion.each(of)
        name = "" if name == "<lambda>" else name
    elif of in observed:
        name, values = of, observed[of][:, -1] if at_end else observed[of]
    elif of in QUANTITIES:
        behind, _, units, _ = QUANTITIES[of]
        name, values = of, getattr(motion, of)
        axes = _COMPONENTS.get(behind[0], "") if len(behind) == 1 else ""
    else:
        known = ", ".join([*observed, *QUANTITIES])
        raise FieldError("Ensemble.plot.of", of, "is not known", f"use one of {known}")
    values = np.asarray(values, dtype=float)
    front = values.shape[: 1 if at_end else 2]
    values = values.reshape(*front, -1)
    count = values.shape[-1]
    name = name.replace("_", " ")
    unit = f" [{units}]" if units else ""
    parts = axes or ([""] if count == 1 else [str(k) for k in range(count)])
    labels = tuple(f"{name} {part}".strip() + unit for part in parts)
    return Shown(values, labels, units)


def _fan(ensemble: Ensemble, seen: Shown) -> "Figure":
    count = min(len(seen.labels), _MOST_PANELS)
    time = np.asarray(ensemble.time, dtype=float)
    finite = np.isfinite(seen.values)
    under_way = finite.all(axis=-1).sum(axis=0)
    # of what hardly moves beside the others no more is shown than that
    least = 1e-4 * float(np.ptp(seen.values[finite])) if finite.any() else 0.0
    fewer = bool((under_way < len(seen.values)).any())
    figure = new_figure((8.0, 0.8 + 2.2 * count + 1.2 * fewer))
    heights = [1.0] * count + [0.5] * fewer
    how: Any = {"sharex": True, "squeeze": False, "height_ratios": heights}
    panels: Any = figure.subplots(len(heights), 1, **how)[:, 0]
    if fewer:
        panels[-1].fill_between(time, under_way, color=GREEN, alpha=0.3, lw=0)
        panels[-1].set_ylim(0.0, 1.05 * len(seen.values))
        panels[-1].set_ylabel("members\nunder way")
        dress(panels[-1])
    for k, panel in enumerate(panels[:count]):
        values = seen.values[:, :, k]
        for low, high, opacity in _BANDS:
            bounds = quantiles(values, (low, high))
            share = f"{100.0 * (high - low):.0f} % of the members"
            share += " under way" if fewer else ""
            panel.fill_between(
                *(time, *bounds), color=BLUE, alpha=opacity, lw=0, label=share
            )
        (middle,) = quantiles(values, (0.5,))
        panel.plot(time, middle, color=BLUE, lw=1.4, label="median")
        widest = quantiles(values, _BANDS[0][:2])
        panel.set_ylim(*limits(np.asarray(widest), 0.06, least))
        panel.set_ylabel(seen.labels[k])
        dress(panel)
    panels[0].legend(fontsize=8, frameon=False, ncols=3, loc="best")
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(*limits(time, 0.0))
    figure.align_ylabels(panels)
    return figure


def quantiles(values: np.ndarray, shares: tuple[float, ...]) -> np.ndarray:
    """Quantiles over the finite values of each column; NaN where none is.

    Args:
        values: Shape (N, T).
        shares: From 0 to 1 [1].

    Returns:
        Shape (shares, T), between neighbours linear.
    """
    finite = np.isfinite(values)
    ranked = np.sort(np.where(finite, values, np.nan), axis=0)  # NaN come last
    count = finite.sum(axis=0)
    places = np.asarray(shares)[:, None] * np.maximum(count - 1, 0)
    below = np.floor(places).astype(int)
    above = np.minimum(below + 1, np.maximum(count - 1, 0))
    low, high = (np.take_along_axis(ranked, at, axis=0) for at in (below, above))
    return low + (places - below) * (high - low)


def _histograms(ensemble: Ensemble, seen: Shown) -> "Figure":
    count = min(len(seen.labels), _MOST_PANELS)
    figure = new_figure((1.0 + 3.4 * count if count > 1 else 6.5, 4.2))
    panels = figure.subplots(1, count, sharey=True, squeeze=False)[0]
    outcomes = _outcomes(ensemble)
    for k, panel in enumerate(panels):
        values = seen.values[:, k]
        finite = np.isfinite(values)
        groups = [values[flags & finite] for flags in outcomes.values()]
        panel.hist(
            groups,
            bins=_bins(values[finite]),
            stacked=True,
            color=[_COLOURS[i % len(_COLOURS)] for i in range(len(groups))],
            label=_legend(outcomes, finite),
        )
        panel.set_xlabel(seen.labels[k])
        dress(panel)
    panels[0].set_ylabel("members")
    if len(outcomes) > 1:
        panels[0].legend(fontsize=8, frameon=False)
    return figure


def _bins(values: np.ndarray) -> np.ndarray:
    """Edges of bins: of Freedman and Diaconis' width, or more (Rice's 2 n^(1/3))."""
    if not values.size or np.ptp(values) == 0.0:
        return np.linspace(*limits(values, 0.0), 2)
    low, high = float(values.min()), float(values.max())
    few = 2.0 * values.size ** (1.0 / 3.0)
    spread = float(np.subtract(*np.quantile(values, (0.75, 0.25))))
    count = 0.5 * few * (high - low) / max(spread, (high - low) / _MOST_BINS)
    return np.linspace(low, high, round(min(max(count, few), _MOST_BINS)) + 1)


def _scatter(ensemble: Ensemble, seen: Shown) -> "Figure":
    if len(seen.labels) < 2:
        raise FieldError(
            "Ensemble.plot.of",
            ", ".join(seen.labels),
            "is one number, and a scatter plot needs two",
            'give a function that returns two, or kind="histogram"',
        )
    x, y = seen.values[:, 0], seen.values[:, 1]
    finite = np.isfinite(x) & np.isfinite(y)
    (left, right), (low, high) = (limits(v[finite], 0.06) for v in (x, y))
    ratio = (high - low) / (right - left) if seen.units == "m" else 0.8
    figure = new_figure((7.5, 1.0 + 6.5 * float(np.clip(ratio, 0.35, 1.2))))
    panel = figure.add_subplot(xlim=(left, right), ylim=(low, high))
    outcomes = _outcomes(ensemble)
    size = float(np.clip(6e3 / max(len(x), 1), 1.5, 30.0))
    for i, (flags, label) in enumerate(
        zip(outcomes.values(), _legend(outcomes, finite), strict=True)
    ):
        own = flags & finite
        colour = _COLOURS[i % len(_COLOURS)]
        panel.scatter(
            x[own], y[own], s=size, color=colour, alpha=0.6, lw=0, label=label
        )
    panel.set_xlabel(seen.labels[0])
    panel.set_ylabel(seen.labels[1])
    if seen.units == "m":
        panel.set_aspect("equal")
    dress(panel)
    if len(outcomes) > 1 or not finite.all():
        _name_colours(panel)
    return figure


def _name_colours(panel: "Axes") -> None:
    """A legend above the panel, where no point is; of full colour."""
    legend = panel.legend(
        fontsize=9,
        frameon=False,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=3,
        markerscale=2.0,
    )
    for handle in legend.legend_handles:
        if handle is not None:
            handle.set_alpha(1.0)


def _outcomes(ensemble: Ensemble) -> dict[str, np.ndarray]:
    """Which members ended how, from the most frequent."""
    every = ensemble.outcomes
    names, counts = np.unique(every, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return {_short(name): every == name for name in names[order].tolist()}


def _short(name: str) -> str:
    return name.removeprefix("stopped: ")  # an event's name says enough


def _legend(outcomes: dict[str, np.ndarray], finite: np.ndarray) -> list[str]:
    """Names with counts, and how many of them have no value to draw."""
    found: list[str] = []
    for name, flags in outcomes.items():
        count, lost = int(flags.sum()), int((flags & ~finite).sum())
        without = f" ({lost:,} without a value)" if lost else ""
        found.append(f"{count:,} {name}{without}")
    return found
