"""A picture of sensitivities: derivatives of each observable against time."""

import os
from typing import TYPE_CHECKING

import numpy as np

from ..identification.sensitivity import Sensitivity
from .envelopes import draw_curve
from .plot_style import INK, LINES, dress, new_figure, write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_sensitivity(
    found: Sensitivity, path: str | os.PathLike[str] | None = None
) -> "Figure | None":
    """Derivatives against time: a row for each observable, a column for each parameter.

    Of an observable with several numbers, the root of the sum of their squares.

    Args:
        found: The sensitivities.
        path: PNG file to write; None for none.

    Returns:
        The figure, or None where a file was written.
    """
    rows, columns = len(found.observed), len(found.names)
    figure = new_figure((4.6 * columns + 0.6, 2.7 * rows + 0.3))
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for row, (name, slopes) in enumerate(found.values.items()):
        for column, (parameter, slope) in enumerate(slopes.items()):
            panel = panels[row, column]
            inner = tuple(range(1, slope.ndim - 1))
            size = slope if not inner else np.sqrt(np.sum(slope**2, axis=inner))
            for k, label in enumerate(found.names[parameter]):
                short = label.removeprefix(parameter) or parameter
                color, dashes = LINES[k % len(LINES)]
                time = np.asarray(found.time)
                draw_curve(panel, time, np.asarray(size[:, k]), color, short, dashes)
            dress(panel)
            panel.set_title(f"d({name}) / d({parameter})", fontsize=10, color=INK)
            panel.legend(fontsize=8, frameon=False, ncols=2)
            if row == rows - 1:
                panel.set_xlabel("time [s]")
    if path is None:
        return figure
    write_picture(path, figure)
    return None
