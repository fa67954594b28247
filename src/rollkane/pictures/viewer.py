"""A motion as one HTML page that plays in any browser, from disk, without a network.

The page carries everything it needs: the drawing library, the meshes, the motion. Its
own programs lie beside this module in ``viewer_assets``.
"""

import base64
import html
import json
import os
import re
from collections.abc import Sequence
from importlib import resources
from typing import Any

import numpy as np

from ..dynamics.loads import Gravity
from ..files.atomic_file import write_whole
from ..files.file_endings import PAGES, wrong_ending
from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError
from .mesh import Mesh, body_mesh, body_size, surface_mesh
from .motion_samples import MotionSamples, reached_samples
from .rolling_meshes import RollingMeshes, rolling_meshes

# More frames would only make the page larger: it moves smoothly between them.
MOST_FRAMES = 2000
MOST_GHOSTS, _GHOST_FRAMES = 32, 400
_MOST_EVENTS = 500  # marks on the time line
# How far the chords of a round mesh sag, of its width: 88 of them go round, and half of
# (pi / 88)^2 is 6e-4. Beyond what is drawn by less no eye sees a contact.
_SAG = 1e-3
_SCRIPTS = (
    *("three.bundle.js", "motion.js", "marks.js", "stage.js", "timeline.js"),
    *("capture.js", "viewer.js"),
)
_OF_GHOSTS = "position", "velocity", "orientation", "angular_velocity"


def write_view(
    trajectory: Trajectory,
    path: str | os.PathLike[str],
    title: str = "",
    ghosts: Sequence[Trajectory] = (),
) -> None:
    """Write a trajectory as a self-contained page with a moving three-dimensional view.

    The page shows the body and its base as they move, the masses that it carries, the
    contact point with its traces on both, and (by switches) arrows of the contact
    force, gravity and angular velocity with their scales, the axes of the body and the
    fixed ones; it has a slider, a clock, a camera that can follow, a graph of any
    quantity over time with events and the mode of contact, and makes pictures and
    videos of what is seen. ``#frame=N`` behind its name shows frame N at rest. It opens
    from disk and in sandboxed frames, and fetches nothing.

    Args:
        trajectory: One run, not a batch. Of more than 2000 outputs, 2000 are kept.
        path: Where to, .html or .htm; the folder must exist. The file appears whole or
            not at all.
        title: Heading of the page; plain text.
        ghosts: Other runs of the same body, shown as veils; 32 at most.

    Raises:
        FieldError: a batch, a run of which no state is finite, or another ending.
        OSError: the file cannot be written.
    """
    wrong = wrong_ending(path, PAGES)
    if wrong is not None:
        raise FieldError("path", str(path), *wrong)
    write_whole(path, view_page(trajectory, title, ghosts).encode())


def view_page(
    trajectory: Trajectory, title: str = "", ghosts: Sequence[Trajectory] = ()
) -> str:
    """The text of the page that :func:`write_view` writes.

    Args:
        trajectory: One run, not a batch.
        title: Heading of the page; plain text.
        ghosts: Other runs of the same body, shown as veils; 32 at most.

    Raises:
        FieldError: a batch, or a run of which no state is finite; too many ghosts.
    """
    return page_of(view_data(trajectory, title, ghosts), title)


def page_of(
    data: dict[str, Any], title: str, scripts: Sequence[str] = (), connects: str = ""
) -> str:
    """The text of a page that shows what it is given.

    Args:
        data: As of :func:`view_data`.
        title: Heading of the page; plain text.
        scripts: Further programs, behind the others.
        connects: Where the page may ask, as its policy says it; nowhere.
    """
    parts = {
        "title": html.escape(title or "rollkane"),
        "style": _asset("viewer.css"),
        "license": _asset("LICENSE.three").replace("--", "- -"),
        "connects": f"; connect-src {connects}" if connects else "",
        # a browser ends a script at the first "</script", wherever it stands
        "data": json.dumps(data, allow_nan=False)
        .replace("<", "\\u003c")
        .replace("&", "\\u0026"),
        "scripts": "\n".join(
            f"<script>\n{_asset(s)}\n</script>" for s in (*_SCRIPTS, *scripts)
        ),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda m: parts[m[1]], _asset("template.html"))


def view_data(
    trajectory: Trajectory,
    title: str = "",
    ghosts: Sequence[Trajectory] = (),
    shapes: bool = True,
    drawn: Sequence[Any] = (),
) -> dict[str, Any]:
    """What the page's programs are given, ready for JSON.

    Args:
        trajectory: One run, not a batch.
        title: Heading of the page.
        ghosts: Other runs of the same body.
        shapes: Whether with ``size``, ``body``, ``base`` and ``rolling``, which do not
            change where surfaces stay the same.
        drawn: What is drawn of them already, boxes of the meshes of the base, the body
            and each rolling body and what it rolls on, from their lowest to their
            highest corner [m], or None: they come, too, where the motion leaves these.

    Returns:
        ``title``, ``note`` (why the run ended early), ``size`` (reach of the body from
        its origin [m]), ``force`` (a usual contact force [N]), ``carried`` (masses of
        the carried points [kg]), ``energy_label`` (what the energy column is, and its
        unit), ``frames`` (columns of :class:`MotionSamples`; ``energy`` is the relative
        error where an energy is kept; those of the base only where it moves), ``body``
        and ``base`` (meshes; ``{"plane": True}`` for a plane, None for a surface whose
        chart has no point), ``rolling`` (of each body that rolls on or in the body:
        ``body``, the surface ``on`` which it does, meshes, and its place), ``gravity``
        ([m/s^2], or None), ``events`` (name and times [s] of each), ``ghosts`` (frames
        of each). Arrays are
        written as ``type``, ``unit``, ``shape`` and
        ``data`` (base64, little endian, in that unit); ``points`` of a mesh are shares
        of the box from ``low`` to ``high`` [m].

    Raises:
        FieldError: a batch, or a run of which no state is finite; too many ghosts.
    """
    if len(ghosts) > MOST_GHOSTS:
        remedy = f"give {MOST_GHOSTS} at most, such as every n-th member"
        raise FieldError("ghosts", len(ghosts), "are too many for one picture", remedy)
    motion, reached = reached_samples(trajectory)
    scene = trajectory.scene
    forces = np.linalg.norm(motion.contact_force, axis=1)
    note = ""
    if not bool(trajectory.succeeded):
        reason = trajectory.reason.split(":")[0]
        note = f"stopped at {float(trajectory.final_time):.6g} s: {reason}"
    renewed = shapes or _leaves(motion, drawn)
    known = _shapes(trajectory, motion) if renewed else {}
    return known | {
        "title": title,
        "note": note,
        "force": float(np.nanmedian(forces)) if np.isfinite(forces).any() else 1.0,
        "carried": motion.masses.tolist(),
        "energy_label": [f"{motion.kept} error", ""]
        if motion.kept
        else ["energy", "J"],
        "frames": _frames(motion) | _mode_frames(trajectory, reached),
        "gravity": _gravity(scene),
        "events": _events(trajectory),
        "ghosts": [_ghost_frames(ghost) for ghost in ghosts],
    }


def _shapes(trajectory: Trajectory, motion: MotionSamples) -> dict[str, Any]:
    """How large the body is, and meshes."""
    scene = trajectory.scene
    size = body_size(scene.body, motion.contact_on_body)
    touched, outward = motion.contact_on_body, motion.body_outward
    body = body_mesh(scene.body.surface, touched, outward, size)
    if body.points.size:
        size = float(np.max(np.linalg.norm(body.points, axis=1)))
    return {
        "size": size,
        "body": _mesh_data(body),
        "rolling": [_rolling_data(own) for own in rolling_meshes(scene, motion, body)],
        "base": _base_data(trajectory, motion, size),
    }


def _leaves(motion: MotionSamples, drawn: Sequence[Any]) -> bool:
    """Whether bodies touch surfaces beyond what is drawn of them."""
    touched = [motion.contact_on_base, motion.contact_on_body]
    for k in range(motion.rolling.shape[1]):
        touched += [
            motion.rolling_column(k, name)
            for name in ("contact_on_body", "contact_on_carrier")
        ]
    for places, box in zip(touched, drawn, strict=False):
        if box is not None:
            low, high = np.asarray(box, dtype=float)
            slack = _SAG * np.max(high - low)
            if (places < low - slack).any() or (places > high + slack).any():
                return True
    return False


def _frames(motion: MotionSamples) -> dict[str, Any]:
    """Columns of at most ``MOST_FRAMES`` rows."""
    count = len(motion.time)
    kept = _kept_rows(count, MOST_FRAMES)
    thin = motion.rows(kept)
    columns = thin.columns
    columns["energy"] = motion.energy_error[kept] if motion.kept else thin.energy
    left_out = {"moving_energy", "rolling"}
    if not motion.alpha.shape[1]:
        left_out |= {"alpha"}
    for k in range(thin.rolling.shape[1]):
        for name in ("position", "velocity", "orientation", "angular_velocity"):
            columns[f"rolling_{k}_{name}"] = thin.rolling_column(k, name)
    if not motion.masses.size:
        left_out |= {"carried"}
    if not motion.base_moves:
        left_out |= {name for name in columns if name.startswith("base_")}
    packed = {
        name: _packed(column, "float32")
        for name, column in columns.items()
        if name not in left_out
    }
    packed["time"] = _packed(thin.time, "float64")
    for name in ("outward", "base_outward", "body_outward"):
        if name in packed:  # they only lift the traces off the surfaces
            packed[name] = _packed(columns[name], "int16", 1 / 32767)
    return packed


def _kept_rows(count: int, most: int) -> np.ndarray:
    """Numbers of at most so many rows, the first and the last among them."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(int)


def _mode_frames(trajectory: Trajectory, reached: np.ndarray) -> dict[str, Any]:
    """How the body touches its base in each frame, where that changes."""
    if trajectory.switches is None:
        return {}
    modes = np.asarray(trajectory.mode)[reached]
    return {"mode": _packed(modes[_kept_rows(len(modes), MOST_FRAMES)], "int8")}


def _gravity(scene: Any) -> list[float] | None:
    """Sum of the scene's uniform fields [m/s^2]; None where it has none."""
    fields = [x.acceleration for x in scene.loads if isinstance(x, Gravity)]
    total = np.sum(np.asarray(fields, dtype=float).reshape(-1, 3), axis=0)
    return total.tolist() if np.any(total) else None


def _events(trajectory: Trajectory) -> list[dict[str, Any]]:
    """Names and times of what happened [s], changes of the contact among it."""
    found: list[dict[str, Any]] = []
    if trajectory.event_record is not None:
        for name, crossings in trajectory.events.items():
            times = np.asarray(crossings.times, dtype=float)
            known = times[np.isfinite(times)][:_MOST_EVENTS]
            found.append({"name": name, "times": known.tolist()})
    return found


def _ghost_frames(trajectory: Trajectory) -> dict[str, Any]:
    """Where a ghost is, at at most ``_GHOST_FRAMES`` of its times."""
    names = "time", *_OF_GHOSTS
    columns = {name: np.asarray(getattr(trajectory, name)) for name in names}
    rows = [columns[name].reshape(len(columns["time"]), -1) for name in names]
    finite = np.flatnonzero(np.isfinite(np.concatenate(rows, axis=1)).all(axis=1))
    kept = finite[_kept_rows(len(finite), _GHOST_FRAMES)]
    packed = {name: _packed(columns[name][kept], "float32") for name in _OF_GHOSTS}
    return packed | {"time": _packed(columns["time"][kept], "float64")}


def _base_data(
    trajectory: Trajectory, motion: MotionSamples, size: float
) -> dict[str, Any] | None:
    """Mesh of the base; of a plane, which the page draws itself, only the word."""
    surface = trajectory.scene.base.surface
    if surface.is_flat:
        return {"plane": True}
    extent = np.max(np.ptp(motion.contact_on_base, axis=0), initial=0.0)
    margin = 1.3 * size + 0.1 * float(extent)
    mesh = surface_mesh(surface, motion.contact_on_base, motion.base_outward, margin)
    return _mesh_data(mesh)


def _rolling_data(own: RollingMeshes) -> dict[str, Any]:
    """A body that rolls on or in the body, and the surface on which it does."""
    return {
        "body": _mesh_data(own.body),
        "on": None if own.on is None else _mesh_data(own.on),
        "carrier": own.carrier,
        "place": own.place.tolist(),
        "turn": own.turn.tolist(),
    }


def _mesh_data(mesh: Mesh) -> dict[str, Any] | None:
    """A mesh for JSON; None for one without triangles."""
    if not mesh.triangles.size:
        return None
    centre = mesh.points.mean(axis=0)
    out = np.sum(mesh.normals * (mesh.points - centre))
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    shares = (mesh.points - low) / np.where(high > low, high - low, 1.0)
    return {
        "low": low.tolist(),
        "high": high.tolist(),
        "points": _packed(shares, "uint16", 1 / 65535),
        "normals": _packed(mesh.normals, "int8", 1 / 127),
        "marks": _packed(mesh.marks, "uint16", 1 / 65535),
        "triangles": _packed(mesh.triangles, "uint16"),
        "cells": list(mesh.cells),
        "hollow": bool(out < 0),
    }


def _packed(array: np.ndarray, dtype: str, unit: float = 1.0) -> dict[str, Any]:
    """An array for JSON; as whole numbers of a unit where dtype is one of integers."""
    if unit != 1.0:
        array = np.rint(array / unit)
    with np.errstate(over="ignore"):  # what single precision cannot hold is infinite
        narrow = np.ascontiguousarray(array, np.dtype(dtype).newbyteorder("<"))
    return {
        "type": dtype,
        "unit": unit,
        "shape": list(narrow.shape),
        "data": base64.b64encode(narrow.tobytes()).decode("ascii"),
    }


def _asset(name: str) -> str:
    folder = resources.files("rollkane.pictures") / "viewer_assets"
    return (folder / name).read_text(encoding="utf-8")
