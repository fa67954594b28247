"""The picture of what accuracy costs: error and energy error against time."""

from collections.abc import Callable
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ..studies.timing import Measured
from ..studies.work_precision import WorkPrecision
from .plot_style import (
    BLUE,
    BROWN,
    GREEN,
    INK,
    PURPLE,
    RED,
    dress,
    new_figure,
    write_picture,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = (BLUE, GREEN, PURPLE, BROWN, RED, INK)
_MARKS = "osD^vP"
_USUAL = ("double", "pole-free", "rolling")
_DOTTED = (":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 3)))


def figure_work_precision(work: WorkPrecision, title: str = "") -> "Figure":
    """Error at the end, and change of the energy, against the time of a run.

    Args:
        work: The measurements.
        title: Above the figure.

    Raises:
        ImportError: matplotlib is not installed.
    """
    has_energy = any(row.energy_error is not None for row in work.rows)
    figure = new_figure((10.5 if has_energy else 7.5, 4.6))
    panels = figure.subplots(1, 2 if has_energy else 1, squeeze=False, sharey=True)[0]
    panels[0].set_xlabel("error at the end: position [m] or rotation [rad]")
    panels[0].set_ylabel("time of a run [ms]")
    _draw(panels[0], work, lambda row: max(row.error, work.certainty))
    panels[0].axvspan(
        *(0.3 * work.certainty, work.certainty),
        color="#eceff3",
        zorder=0,
        label="unknown",
    )
    if has_energy:
        panels[1].set_xlabel("relative change of the energy")
        _draw(panels[1], work, lambda row: row.energy_error)
    panels[-1].legend(
        fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5)
    )
    figure.suptitle(f"{title}, {work.horizon:g} s", color=INK, fontsize=12)
    return figure


def _draw(
    panel: "Axes", work: WorkPrecision, measure: Callable[[Measured], float | None]
) -> None:
    """A line for each series; colours by solver, dashes by method and the rest."""
    series = list(dict.fromkeys(row.setting.series for row in work.rows))
    solvers = list(dict.fromkeys(row.setting.solver for row in work.rows))
    rest = dict.fromkeys(map(_rest, work.rows))
    others = [x for x in rest if x != _USUAL]
    for name in series:
        rows = [row for row in work.rows if row.setting.series == name and not row.code]
        points = [(measure(row), 1e3 * row.seconds) for row in rows]
        known = np.array([p for p in points if p[0] is not None], float).reshape(-1, 2)
        if not len(known):
            continue
        known[:, 0] = np.maximum(known[:, 0], 1e-17)
        which = solvers.index(rows[0].setting.solver) % len(_COLOURS)
        panel.loglog(
            *known.T,
            color=_COLOURS[which],
            marker=_MARKS[which],
            markersize=4,
            linewidth=1.2,
            linestyle=_dashes(rows[0], others),
            markerfacecolor="white" if rows[0].setting.steps else None,
            label=name,
        )
    from matplotlib.ticker import LogLocator

    # a series may fill less than a decade, or two: labels at 1, 2 and 5 fit both
    panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.yaxis.set_major_formatter("{x:g}")
    panel.yaxis.set_minor_formatter("")
    dress(panel)


def _rest(row: Measured) -> tuple[str, str, str]:
    setting = row.setting
    return setting.precision, setting.coordinates, setting.formulation


def _dashes(row: Measured, others: list[tuple[str, str, str]]) -> Any:
    rest = _rest(row)
    if rest == _USUAL:
        return "-" if row.setting.method == "native" else "--"
    return _DOTTED[others.index(rest) % len(_DOTTED)]


def plot_work_precision(
    work: WorkPrecision, path: str | PathLike[str], title: str = ""
) -> None:
    """Write the picture as a PNG, SVG or PDF file.

    Args:
        work: The measurements.
        path: File to write, whole or not at all.
        title: Above the figure.
    """
    write_picture(path, figure_work_precision(work, title))
