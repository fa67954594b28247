"""A picture of a system's motion by Kane's method.

Needs matplotlib, which is imported inside the functions.
"""

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from ..kane.motion import KaneTrajectory
from .envelopes import draw_curve
from .plot_style import LINES, PURPLE, dress, given, limits, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST = 8  # curves of one panel


def plot_kane(
    run: KaneTrajectory, path: str | os.PathLike[str] | None = None, title: str = ""
) -> "Figure | None":
    """Coordinates, speeds and kinetic energy [J] against time.

    Args:
        run: One run, not a batch; the first eight coordinates and speeds are drawn.
        path: PNG, SVG or PDF file to write; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.
    """
    figure = new_figure((8.0, 6.0))
    panels: Any = figure.subplots(3, 1, sharex=True)
    time = np.asarray(run.time, float)
    for panel, letter, name in zip(
        panels, "qu", ("coordinates", "speeds"), strict=False
    ):
        values = np.asarray(getattr(run, letter), float)[:, :_MOST]
        for k, column in enumerate(values.T):
            color, dashes = LINES[k % len(LINES)]
            draw_curve(panel, time, column, color, f"{letter}[{k}]", dashes)
        panel.set_ylim(*limits(values, 0.08, 1e-9))
        panel.set_ylabel(name)
        panel.legend(fontsize=8, frameon=False, ncols=8, loc="upper right")
    energy = np.asarray(run.kinetic_energy, float)
    draw_curve(panels[2], time, energy, PURPLE)
    panels[2].set_ylim(*limits(energy, 0.08, 1e-12))
    panels[2].set_ylabel("kinetic energy [J]")
    panels[2].set_xlabel("time [s]")
    for panel in panels:
        dress(panel)
    figure.align_ylabels(panels)
    return given(figure, path, title)
