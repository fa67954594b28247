"""How all pictures look: colours, panels, ranges, and the way to a file."""

import io
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ..files.atomic_file import write_whole
from ..files.file_endings import PICTURES, ending, wrong_ending
from ..validation.checks import FieldError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, GREEN, PURPLE, BROWN = "#1f5fa8", "#2a7f62", "#6b4fa0", "#9a5b13"
RED, INK, FAINT = "#c23b3b", "#333a44", "#b8c0cb"
# lines that are told apart in grey, too: by their dashes
LINES = (
    *((BLUE, "-"), (RED, "--"), (GREEN, "-."), (PURPLE, ":")),
    *((BROWN, (0, (5, 1))), (INK, (0, (3, 1, 1, 1)))),
)
DPI = 150


def new_figure(inches: tuple[float, float]) -> "Figure":
    """An empty figure that belongs to no window and to no global state.

    Args:
        inches: Width and height [in].

    Raises:
        ImportError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(
            "pictures need matplotlib: pip install 'rollkane[plot]'"
        ) from error
    figure = Figure(figsize=inches, dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def png(figure: "Figure", dpi: int = DPI) -> bytes:
    """The figure as a PNG file's bytes.

    Args:
        figure: What to write.
        dpi: Dots per inch.
    """
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=dpi)
    return picture.getvalue()


def write_picture(path: str | PathLike[str], figure: "Figure") -> None:
    """Write a figure, whole or not at all: PNG, SVG or PDF, as the file's ending says.

    Args:
        path: Ends in .png, .svg or .pdf; its folder must exist.
        figure: What to write.

    Raises:
        FieldError: another ending, or none.
        OSError: the file cannot be written.
    """
    wrong = wrong_ending(path, PICTURES)
    if wrong is not None:
        raise FieldError("path", str(path), *wrong)
    kind = ending(path)[1:]
    # without the time of day, the same figure is the same file
    dated: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    picture = io.BytesIO()
    figure.savefig(picture, format=kind, dpi=DPI, metadata=dated.get(kind))
    write_whole(path, picture.getvalue())


def given(
    figure: "Figure", path: str | PathLike[str] | None, title: str = ""
) -> "Figure | None":
    """The figure with its title, or the file that it is written to.

    Args:
        figure: What was drawn.
        path: File, as of :func:`write_picture`; None for none.
        title: Above the figure; plain text.

    Returns:
        The figure, or None where a file was written.

    Raises:
        FieldError: another ending, or none.
        OSError: the file cannot be written.
    """
    if title:
        figure.suptitle(title, fontsize=11, color=INK, parse_math=False)
    if path is None:
        return figure
    write_picture(path, figure)
    return None


def dress(panel: "Axes") -> None:
    """Give a panel of two dimensions the common grid, spines and colours."""
    panel.grid(True, color="#e6e9ee", linewidth=0.8)
    panel.set_axisbelow(True)
    panel.tick_params(colors=INK, labelsize=9)
    panel.xaxis.label.set_color(INK)
    panel.yaxis.label.set_color(INK)
    for side, spine in panel.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(FAINT)


def limits(
    values: np.ndarray, margin: float, least: float = 0.0
) -> tuple[float, float]:
    """Range of the finite values among some, never of no width.

    Args:
        values: Any shape; may hold NaN.
        margin: Share of the half range that is added on each side [1].
        least: Smallest half range [unit of the values].

    Returns:
        Low and high; (0, 1) where nothing is finite.
    """
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if half <= 1e-6 * abs(middle):  # constant but for rounding
        half = 0.05 * abs(middle)
    half = (1.0 + margin) * max(half, least, 1e-12)
    return middle - half, middle + half
