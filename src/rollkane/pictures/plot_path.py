"""The path of the contact point on the base: from above, or in space."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.surfaces import AbstractSurface, Cone
from .mesh import chart_points, surface_mesh
from .motion_samples import MotionSamples
from .plot_style import FAINT, INK, RED, dress, limits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import Collection
    from matplotlib.ticker import MaxNLocator

_Axes3D = Any  # mpl_toolkits has no types


# Of a panel: what a legend takes of its width and its height.
_LEGEND = 0.45, 0.25


def draw_path(
    panel: "Axes",
    motion: MotionSamples,
    base: AbstractSurface | None = None,
    colorbar: bool = True,
    in_space: bool = False,
) -> None:
    """Draw the contact's path seen from above into a panel, coloured by time.

    Args:
        panel: Axes of matplotlib, of two dimensions.
        motion: The motion; what it did not reach is left out. In flight its rows hold
            the body's origin, which is drawn dotted.
        base: Surface whose height lines are drawn below the path; None for none.
        colorbar: Whether a scale of times is put beside the panel.
        in_space: Whether the path is that in fixed axes, not that on a moving base.
    """
    from matplotlib.collections import LineCollection

    kept = motion.rows(motion.reached)
    path = (kept.contact if in_space else kept.contact_on_base)[:, :2]
    spread = _spread(path)
    factor, unit = _length_unit(spread)
    x, y = factor * path.T
    _draw_flights(panel, kept, x, y)
    lines = LineCollection(_pieces(kept, x, y), cmap="viridis", zorder=2)
    lines.set_linewidth(_width(path))
    lines.set_array(0.5 * (kept.time[1:] + kept.time[:-1]))
    lines.set_capstyle("round")
    panel.add_collection(lines, autolim=False)
    least = 0.25 * factor * spread if spread > 0 else 1.0
    panel.set_xlim(*limits(x, 0.15, least))
    panel.set_ylim(*limits(y, 0.15, least))
    panel.set_aspect("equal", adjustable="box")
    if base is not None and base.is_height and not base.is_flat:
        _draw_heights(panel, base, factor)
    _mark_ends(panel, x, y)
    whose = " of the base" if motion.base_moves and not in_space else ""
    panel.set_xlabel(f"x{whose} [{unit}]")
    panel.set_ylabel(f"y{whose} [{unit}]")
    dress(panel)
    if colorbar and kept.time.size > 1:
        _time_scale(panel, lines, kept.time)


def draw_path_in_space(
    panel: _Axes3D, motion: MotionSamples, base: AbstractSurface, size: float
) -> None:
    """Draw the contact's path on a curved base, coloured by time.

    Args:
        panel: Axes of matplotlib, of three dimensions.
        motion: The motion; what it did not reach is left out.
        base: Surface of the base.
        size: How much of a base without ends is drawn beyond the path [m].
    """
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # pyright: ignore[reportMissingTypeStubs]

    kept = motion.rows(motion.reached)
    if not kept.time.size:
        panel.set_axis_off()
        return
    mesh = surface_mesh(base, kept.contact_on_base, kept.base_outward, size, (49, 25))
    shown = mesh.points if mesh.triangles.size else kept.contact_on_base
    factor, unit = _length_unit(_spread(shown))
    panel.computed_zorder = False  # the path is never washed out by the surface
    facing = _turn_towards(panel, kept.base_outward)
    if mesh.triangles.size:
        panel.plot_trisurf(
            *(factor * mesh.points.T),
            triangles=mesh.triangles,
            color="#d7dee8",
            alpha=0.3,
            edgecolor="#9aa7b8",
            linewidth=0.12,
            shade=True,
            zorder=1,
        )
    columns = factor * kept.contact_on_base.T
    seen = np.where(facing[1:] & facing[:-1], 1.0, 0.35)
    _draw_flights(panel, kept, *columns)
    lines = Line3DCollection(_pieces(kept, *columns), cmap="viridis", zorder=3)
    lines.set_linewidth(1.3 * _width(kept.contact_on_base))
    lines.set_array(0.5 * (kept.time[1:] + kept.time[:-1]))
    lines.set_alpha(seen.tolist())
    panel.add_collection3d(lines, autolim=False)
    _mark_ends(panel, *columns)
    panel.set_aspect("equal")
    whose = " of the base" if motion.base_moves else ""
    for name in "xyz":
        getattr(panel, f"set_{name}label")(f"{name}{whose} [{unit}]", color=INK)
        axis = getattr(panel, f"{name}axis")
        axis.set_pane_color((0.97, 0.975, 0.985, 1.0))
        axis.line.set_color(FAINT)
        axis.set_major_locator(_few_ticks())
    panel.grid(False)
    panel.tick_params(colors=INK, labelsize=8)
    if kept.time.size > 1:
        _time_scale(panel, lines, kept.time)


def _turn_towards(panel: _Axes3D, outward: np.ndarray) -> np.ndarray:
    """Look from where most of the path is seen; which of its points face the eye."""
    x, y, z = np.mean(outward, axis=0)
    turn = np.degrees(np.arctan2(y, x)) if np.hypot(x, y) > 0.1 else -60.0
    lift = np.degrees(np.arctan2(z, np.hypot(x, y)))
    panel.view_init(elev=float(np.clip(lift, 15.0, 50.0)), azim=turn + 25.0)
    elev, azim = np.radians(panel.elev), np.radians(panel.azim)
    eye = [np.cos(elev) * np.cos(azim), np.cos(elev) * np.sin(azim), np.sin(elev)]
    return outward @ np.array(eye) > 0


def _width(path: np.ndarray) -> float:
    """Line width [pt]: thinner where a path winds more in its own space."""
    length = np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1))
    turns = length / max(_spread(path), 1e-300)
    return float(np.clip(8.0 / np.sqrt(max(turns, 1.0)), 0.5, 1.6))


def _few_ticks() -> "MaxNLocator":
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(5)


def _spread(points: np.ndarray) -> float:
    """Largest extent along an axis."""
    if not points.size:
        return 0.0
    return float(np.max(np.nanmax(points, axis=0) - np.nanmin(points, axis=0)))


def _pieces(motion: MotionSamples, *columns: np.ndarray) -> list[np.ndarray]:
    """From row to row while there is a contact; NaN elsewhere."""
    corners = np.where(motion.touches[:, None], np.stack(columns, axis=1), np.nan)
    return list(np.stack([corners[:-1], corners[1:]], axis=1))


def _draw_flights(
    panel: "Axes | _Axes3D", motion: MotionSamples, *columns: np.ndarray
) -> None:
    """The path of the body's origin while there is no contact."""
    if motion.touches.all():
        return
    shown = [np.where(motion.touches, np.nan, x) for x in columns]
    label = "body's origin in flight"
    panel.plot(*shown, color=INK, lw=1.0, ls=":", label=label, zorder=3)


def _length_unit(spread: float) -> tuple[float, str]:
    """Factor from metres, and unit, that give readable numbers."""
    for factor, unit in ((1.0, "m"), (1e3, "mm"), (1e6, "µm")):
        if spread * factor >= 0.2:
            return factor, unit
    return (1e6, "µm") if spread > 0 else (1e3, "mm")


def _mark_ends(panel: "Axes | _Axes3D", *columns: np.ndarray) -> None:
    if not columns[0].size:
        return
    style: dict[str, Any] = {"linestyle": "none", "markersize": 8, "zorder": 5}
    start, end = [c[:1] for c in columns], [c[-1:] for c in columns]
    panel.plot(*start, "o", mfc="white", mec=INK, mew=1.5, label="start", **style)
    panel.plot(*end, "s", mfc=RED, mec="white", mew=1.0, label="end", **style)
    corner = _emptiest_corner(panel, *columns) if len(columns) == 2 else "upper right"
    panel.legend(loc=corner, fontsize=9, framealpha=0.9, edgecolor=FAINT)


def _emptiest_corner(panel: "Axes | _Axes3D", x: np.ndarray, y: np.ndarray) -> Any:
    """That in which the fewest points of a path and of lines lie."""
    drawn = [(line.get_xdata(), line.get_ydata()) for line in panel.get_lines()]
    every = [np.column_stack([x, y]), *(np.column_stack(xy) for xy in drawn)]
    low, high = np.transpose([panel.get_xlim(), panel.get_ylim()])
    right, up = ((np.concatenate(every) - low) / (high - low)).T
    taken = {
        f"{row} {side}": np.sum((beside < _LEGEND[0]) & (below < _LEGEND[1]))
        for row, below in (("upper", 1.0 - up), ("lower", up))
        for side, beside in (("right", 1.0 - right), ("left", right))
    }
    return min(taken, key=lambda corner: taken[corner])


def _time_scale(panel: "Axes | _Axes3D", lines: "Collection", time: np.ndarray) -> None:
    """A scale from the first time to the last, both of which are told."""
    first, last = float(time[0]), float(time[-1])
    lines.set_clim(min(first, last), max(first, last))
    bar: Any = panel.figure.colorbar(lines, ax=panel, shrink=0.9, aspect=28)
    bar.set_label("time [s]", color=INK)
    bar.set_ticks(np.linspace(first, last, 5).tolist())
    bar.solids.set_alpha(1.0)
    bar.ax.tick_params(colors=INK, labelsize=9)
    bar.outline.set_visible(False)


def _draw_heights(panel: "Axes", base: AbstractSurface, factor: float) -> None:
    """Height lines of a graph or a cone below the path."""
    x, y = (np.linspace(*lim(), 81) for lim in (panel.get_xlim, panel.get_ylim))
    q = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) / factor
    if isinstance(base, Cone):  # its chart is polar
        q = np.stack([np.hypot(*q.T), np.arctan2(*q.T[::-1])], axis=1)
    height = chart_points(base, q)[:, 2].reshape(81, 81)
    if np.ptp(height[np.isfinite(height)]) > 0:
        lines = panel.contour(
            x, y, factor * height, 9, colors=FAINT, linewidths=0.8, zorder=1
        )
        panel.clabel(lines, fontsize=7, colors="#7a8493", fmt="%.3g")
