"""The diagram of a family of steady motions, with its stability."""

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from ..stability.branch import Branch
from .plot_style import BLUE, INK, RED, dress, given, limits, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_UNITS = {
    "speed": "m/s",
    "tilt": "rad",
    "spin": "rad/s",
    "energy": "J",
    "growth": "1/s",
    "normal force": "N",
}
_MARKS = {"fold": "s", "zero crossing": "o", "Hopf": "D", "collision": "^"}


def plot_family(
    branches: Branch | list[Branch],
    path: str | PathLike[str] | None = None,
    show: str | None = None,
    title: str = "",
) -> "Figure | None":
    """Draw the diagram of branches.

    Args:
        branches: Of the same family: one, or those that meet at bifurcations.
        path: PNG, SVG or PDF file to write; None for none.
        show: A quantity by its name, as of ``Branch.along``, or "growth" [1/s]; None:
            the growth.
        title: Above the picture.

    Returns:
        The figure, or None where a file was written.

    Raises:
        FieldError: nothing of the branches has the name.
    """
    drawn = [branches] if isinstance(branches, Branch) else list(branches)
    name = "growth" if show is None else show
    figure = new_figure((7.0, 4.6))
    panel = figure.add_subplot()
    dress(panel)
    heights = [_heights(branch, name) for branch in drawn]
    for branch, y in zip(drawn, heights, strict=True):
        _draw(panel, branch, y)
        _mark(panel, branch, y)
    panel.set_ylim(*limits(np.concatenate(heights), 0.08, 1e-9))
    panel.set_xlabel(_with_unit(drawn[0].vary.removeprefix("hold.")))
    panel.set_ylabel(_with_unit(name))
    panel.set_title(title, fontsize=10, color=INK)
    panel.legend(fontsize=8, frameon=False)
    return given(figure, path)


def _with_unit(name: str) -> str:
    return f"{name} [{_UNITS[name]}]" if name in _UNITS else name


def _heights(branch: Branch, name: str) -> np.ndarray:
    if name == "growth":
        rows = [np.max(np.real(p.eigenvalues), initial=0.0) for p in branch.points]
        return np.array(rows)
    return branch.along(name)


def _draw(panel: "Axes", branch: Branch, y: np.ndarray) -> None:
    """Each run of stable or unstable points as one line, up to its neighbours'."""
    x, stable = branch.values, branch.stable
    ends = np.flatnonzero(np.diff(stable)) + 1
    seen = {line.get_label() for line in panel.get_lines()}
    for part in np.split(np.arange(x.size), ends):
        good = bool(stable[part[0]])
        label = "stable" if good else "unstable"
        wide = slice(int(part[0]), int(part[-1]) + 2)
        panel.plot(
            x[wide],
            y[wide],
            color=BLUE if good else RED,
            linestyle="-" if good else "--",
            label="_" if label in seen else label,
        )
        seen.add(label)


def _mark(panel: "Axes", branch: Branch, y: np.ndarray) -> None:
    order = np.argsort(branch.values)
    seen: set[str] = set()
    for critical in branch.critical:
        height = np.interp(critical.value, branch.values[order], y[order])
        panel.plot(
            [critical.value],
            [height],
            marker=_MARKS[critical.kind],
            color=INK,
            linestyle="none",
            label="_" if critical.kind in seen else critical.kind,
        )
        seen.add(critical.kind)
