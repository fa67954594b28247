"""Pictures of a sweep: what was observed against the numbers that vary.

Needs matplotlib, which is imported inside the functions.
"""

import os
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..validation.checks import FieldError
from .plot_style import BLUE, INK, RED, dress, limits, new_figure, write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PANELS, _SIDE_BY_SIDE = 6, 3
_AS_ASKED = re.compile("completed|stopped: .*")  # the latter by an event

# paths of a scene file and their values
Grids = Sequence[tuple[str, Sequence[float]]]


def plot_sweep(
    grids: Grids,
    columns: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    path: str | os.PathLike[str],
    title: str = "",
) -> None:
    """Draw a sweep as a PNG, SVG or PDF file, whole or not at all.

    Of one number that varies: last values as a line, and the band between the least and
    the greatest. Of two: last values as colours. A cross marks what ended early.

    Args:
        grids: What varied and its values, one or two; the last one fastest.
        columns: ``NAME_last``, ``NAME_min``, ``NAME_max`` of each observed number and
            ``outcome``, shape (N,).
        units: Of what was observed, by name.
        path: Where to; the folder must exist.
        title: Above the figure; plain text.

    Raises:
        ImportError: matplotlib is not installed.
        FieldError: another number of what varied, or another ending.
        OSError: the file cannot be written.
    """
    if len(grids) not in (1, 2):
        names = [name for name, _ in grids]
        raise FieldError("grids", names, "are not one or two", "write a table instead")
    names = [name.removesuffix("_last") for name in columns if name.endswith("_last")]
    names = names[:_MOST_PANELS]
    draw = _lines if len(grids) == 1 else _colours
    figure = draw(grids, columns, names, [_labelled(name, units) for name in names])
    if title:
        figure.suptitle(title, fontsize=11, color=INK, parse_math=False)
    write_picture(path, figure)


def _early(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Which motions ended otherwise than they should."""
    return np.array([not _AS_ASKED.fullmatch(x) for x in columns["outcome"]])


def _labelled(name: str, units: Mapping[str, str]) -> str:
    quantity = max((unit for unit in units if name.startswith(unit)), key=len)
    return f"{name.replace('_', ' ')} [{units[quantity]}]"


def _lines(
    grids: Grids,
    columns: Mapping[str, np.ndarray],
    names: Sequence[str],
    labels: Sequence[str],
) -> "Figure":
    ((path, values),) = grids
    x = np.asarray(values)
    figure = new_figure((7.5, 0.8 + 2.4 * len(names)))
    panels: Any = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    early = _early(columns)
    for panel, name, label in zip(panels, names, labels, strict=True):
        three = [columns[f"{name}_{k}"] for k in ("last", "min", "max")]
        last, low, high = three
        panel.fill_between(
            x, low, high, color=BLUE, alpha=0.18, lw=0, label="least to greatest"
        )
        panel.plot(x, last, color=BLUE, lw=1.3, marker=".", label="at the end")
        seen = np.concatenate(three)
        _cross(panel, x[early], np.full(int(early.sum()), limits(seen, 0.05)[0]))
        panel.set_ylim(*limits(seen, 0.08))
        panel.set_ylabel(label)
        dress(panel)
    panels[0].legend(fontsize=8, frameon=False, ncols=3, loc="best")
    panels[-1].set_xlabel(path)
    figure.align_ylabels(panels)
    return figure


def _colours(
    grids: Grids,
    columns: Mapping[str, np.ndarray],
    names: Sequence[str],
    labels: Sequence[str],
) -> "Figure":
    (down, ys), (across, xs) = grids
    wide = min(len(names), _SIDE_BY_SIDE)
    high = -(-len(names) // wide)
    figure = new_figure((1.0 + 5.2 * wide, 0.4 + 4.0 * high))
    panels = figure.subplots(high, wide, sharey=True, squeeze=False)
    shape = len(ys), len(xs)
    early = _early(columns).reshape(shape)
    rows, places = np.nonzero(early)
    for panel, name, label in zip(panels.flat, names, labels, strict=False):
        last = np.asarray(columns[f"{name}_last"], float).reshape(shape)
        low, top, ticks = _scale(last)
        mesh = panel.pcolormesh(
            *(xs, ys, np.ma.masked_invalid(last)),
            shading="nearest",
            cmap="cividis",
            vmin=low,
            vmax=top,
        )
        bar = figure.colorbar(mesh, ax=panel, format="%.4g")
        bar.set_label(f"{label} at the end", color=INK)
        bar.set_ticks(ticks)
        _cross(panel, np.asarray(xs)[places], np.asarray(ys)[rows])
        panel.set_xlabel(across)
        dress(panel)
        panel.grid(False)
    for panel in panels.flat[len(names) :]:
        panel.remove()
    for panel in panels[:, 0]:
        panel.set_ylabel(down)
    return figure


def _scale(values: np.ndarray) -> tuple[float, float, list[float]]:
    """Ends of a scale, and what it tells: of what is constant but for rounding, one."""
    low, high = limits(values, 0.0)
    known = values[np.isfinite(values)]
    if not known.size:
        return low, high, []
    least, greatest = float(known.min()), float(known.max())
    if greatest - least < 0.99 * (high - low):  # else the same but for rounding
        return low, high, [0.5 * (least + greatest)]
    return least, greatest, np.linspace(least, greatest, 5).tolist()


def _cross(panel: "Axes", x: np.ndarray, y: np.ndarray) -> None:
    if x.size:
        how: Any = {"linestyle": "none", "color": RED, "label": "ended early"}
        panel.plot(x, y, marker="x", **how)
