"""Motions as labelled data sets, and as NetCDF files.

Needs the extra ``rollkane[results]`` (xarray, h5netcdf, h5py).
"""

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Array

from .. import __version__
from ..codegen.compile_effort import for_many_numbers, for_one_call
from ..dynamics.rolling_body_observables import paths_of_rolling
from ..dynamics.scene import Scene
from ..hybrid.modes import HybridScene
from ..simulation.ensemble_result import Ensemble
from ..simulation.motion import AbstractMotion
from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError
from .atomic_file import write_whole
from .export_events import event_variables
from .file_endings import NETCDF, wrong_ending

if TYPE_CHECKING:
    import xarray

_AXIS = ("axis",)
# name: (dimensions behind time, what it is, unit, axes); those of every run
ALWAYS = {
    "position": (_AXIS, "body origin", "m", "fixed"),
    "velocity": (_AXIS, "velocity of the body origin", "m/s", "fixed"),
    "orientation": (
        ("quaternion",),
        "unit quaternion, scalar first, body to fixed axes",
        "1",
        "body to fixed",
    ),
    "angular_velocity": (_AXIS, "angular velocity", "rad/s", "fixed"),
    "contact_on_body": (_AXIS, "contact point from the body origin", "m", "body"),
    "contact_on_base": (_AXIS, "contact point on the base", "m", "base"),
    "contact_force": (_AXIS, "force of the base on the body", "N", "fixed"),
    "normal_force": ((), "normal force, positive while pressed together", "N", ""),
    "friction_ratio": ((), "friction coefficient that rolling needs", "1", ""),
    "energy": ((), "kinetic plus potential energy", "J", ""),
}
_MOVING = {
    "base_position": (_AXIS, "base origin", "m", "fixed"),
    "base_rotation": (
        ("axis", "base_axis"),
        "rotation matrix, base to fixed axes",
        "1",
        "base to fixed",
    ),
    "moving_energy": (
        (),
        "energy less v_Oc . P and w_c . J_Oc, Oc the base's origin",
        "J",
        "",
    ),
}
_WORK = {"power": ((), "rate at which energy is given to the system", "W", "")}
_SLIDING = {"slip": (_AXIS, "velocity of the body over the base", "m/s", "fixed")}
_SUPPORTED = {
    "alpha": (("coordinate",), "coordinates of what is supported", "", ""),
    "alpha_dot": (("coordinate",), "their rates", "", ""),
}
ROLLING = {
    "position": (_AXIS, "its origin", "m", "fixed"),
    "orientation": (
        ("quaternion",),
        "unit quaternion, scalar first, its own to fixed axes",
        "1",
        "own to fixed",
    ),
    "angular_velocity": (_AXIS, "angular velocity", "rad/s", "fixed"),
    "contact_place": (_AXIS, "where it touches its carrier", "m", "fixed"),
    "contact_force": (_AXIS, "force of its carrier on it", "N", "fixed"),
    "normal_force": ((), "normal force, positive while pressed together", "N", ""),
}
# Outputs of which a faster program is worth its time: with modes it takes 3 to 4 s more
# to compile, and 3.5 us less for each (20,001 of them: 0.04 s for 0.11)
_MANY = 10**6
_MODES = "0 rolls, 1 slips, 2 flies, -1 not reached"
_MODE = {"mode": ((), _MODES, "", "")}
QUANTITIES = ALWAYS | _MOVING | _WORK | _SLIDING
COORDINATES: dict[str, Any] = {
    "axis": ("axis", ["x", "y", "z"]),
    "quaternion": ("quaternion", ["w", "x", "y", "z"]),
}
BASE_AXIS = {"base_axis": ("base_axis", ["x", "y", "z"])}


def to_xarray(trajectory: Trajectory) -> "xarray.Dataset":
    """A trajectory with names, units and axes.

    Args:
        trajectory: One run, or a batch of runs.

    Returns:
        Variables over ``time`` [s]: ``position``, ``velocity``, ``orientation``,
        ``angular_velocity``, ``contact_on_body``, ``contact_on_base``,
        ``contact_force``, ``normal_force``, ``friction_ratio``, ``energy``; where
        something is supported ``alpha`` and ``alpha_dot``; where the base moves
        ``base_position``, ``base_rotation`` and ``moving_energy``; where the contact
        slips ``slip``; where it changes ``slip`` and ``mode``, and over ``switch`` the
        changes ``switch_time`` [s], ``switch_before``, ``switch_after``, those of one
        run that there were, of a batch ``switch_count`` and all that is kept; of each
        event that was looked for ``NAME_count``, and over ``NAME_crossing`` its times
        ``NAME_time`` [s]; of each body that rolls on the body, by its path, the likes
        of ``rolling_0_position``; where the energy may change ``power``.
        Vectors over ``axis`` (x, y, z) or ``quaternion`` (w, x, y, z). How the run
        ended is in the attributes. A batch has ``lane`` in front (``lane_0``,
        ``lane_1``, ... if there are several batch axes), and how each lane ended are
        variables over it. What was not reached is NaN.

    Raises:
        ImportError: xarray is not installed.
        FieldError: an event has a name such as "switch", whose ``switch_time`` is there
            already.
    """
    xarray = imported("xarray")
    lanes = _lanes(trajectory)
    time = np.asarray(trajectory.time)
    first = time.reshape(-1, time.shape[-1])[0]
    # one clock for all lanes is a coordinate; different clocks are data
    shared = bool(np.all((time == first) | (np.isnan(time) & np.isnan(first))))
    along = "time" if shared else "sample"
    scene = trajectory.scene
    variables = quantities(trajectory, scene, (*lanes, along))
    variables |= _switches(trajectory, lanes)
    coordinates = COORDINATES | {
        "time": (
            (along,) if shared else (*lanes, along),
            first if shared else time,
            {"long_name": "time", "units": "s"},
        ),
    }
    attributes = heading(scene)
    if scene.base.motion is not None:
        coordinates |= BASE_AXIS
    ends = _ends(trajectory)
    if lanes:
        variables |= {name: (lanes, value) for name, value in ends.items()}
    else:
        attributes |= {name: value.item() for name, value in ends.items()}
        attributes["reason"] = trajectory.reason
    variables |= event_variables(trajectory.events or {}, lanes, variables)
    return xarray.Dataset(variables, coordinates, attributes)


def _switches(
    trajectory: Trajectory, lanes: tuple[str, ...]
) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    """Changes of the contact; none in a run without modes."""
    switches = trajectory.switches
    if switches is None:
        return {}
    count, over = np.asarray(switches.count), (*lanes, "switch")
    kept = slice(None) if lanes else slice(int(count))
    about = {
        "time": ("when the contact changed", "s"),
        "before": (f"what it did before: {_MODES}", ""),
        "after": (f"what it did after: {_MODES}", ""),
    }
    found: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {
        f"switch_{name}": (
            over,
            np.asarray(getattr(switches, name))[..., kept],
            labels(*words, ""),
        )
        for name, words in about.items()
    }
    if lanes:
        long_name = labels("how often the contact changed", "1", "")
        found["switch_count"] = lanes, count, long_name
    return found


def quantities(
    motion: AbstractMotion, scene: Scene, front: tuple[str, ...]
) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    """Variables of a data set, by name: dimensions, values and labels.

    Args:
        motion: Whose they are.
        scene: Its scene, which says what there is to be seen.
        front: Dimensions that its states have in front.
    """
    described = dict(ALWAYS)
    moving, changes = scene.base.motion is not None, isinstance(scene, HybridScene)
    if moving:
        described |= _MOVING
    if moving or scene.supported or scene.does_work:
        described |= _WORK
    if scene.contact.slips or changes:
        described |= _SLIDING
    if changes:
        described |= _MODE
    if scene.coordinate_count:
        described |= _SUPPORTED
    values = _values(motion, tuple(described))
    for path in paths_of_rolling(scene):
        place = "_".join(str(k) for k in path)
        inner = _values(motion, tuple(ROLLING), path)
        for name, about in ROLLING.items():
            described[f"rolling_{place}_{name}"] = about
            values[f"rolling_{place}_{name}"] = inner[name]
    return {
        name: ((*front, *behind), np.asarray(values[name]), labels(*about))
        for name, (behind, *about) in described.items()
    }


def heading(scene: Scene) -> dict[str, Any]:
    """What a data set says of itself."""
    moving = scene.base.motion is not None
    return {
        "title": f"motion of a rigid body that {_contact(scene)}",
        "rollkane_version": __version__,
        "axes_note": "right-handed; base axes "
        + ("by base_rotation" if moving else "coincide with the fixed axes"),
    }


def write_netcdf(
    run: "Trajectory | Ensemble | xarray.Dataset", path: str | os.PathLike[str]
) -> None:
    """Write a NetCDF-4 file, whole or not at all.

    Args:
        run: A trajectory, an ensemble, or a data set made from one.
        path: The file, .nc, .nc4, .h5 or .hdf5; replaced if it exists. Its folder must
            exist.

    Raises:
        FieldError: another ending: the file would not be what its name says.
        ImportError: xarray, h5netcdf or h5py is not installed.
        OSError: the folder does not exist, or cannot be written to.
    """
    wrong = wrong_ending(path, NETCDF)
    if wrong is not None:
        raise FieldError("path", str(path), *wrong)
    for module in ("xarray", "h5netcdf", "h5py"):
        imported(module)
    made = isinstance(run, (Trajectory, Ensemble))
    dataset: Any = run.to_xarray() if made else run
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "run.nc"
        dataset.to_netcdf(part, engine="h5netcdf")
        write_whole(path, part.read_bytes())


def imported(module: str) -> Any:
    """A module of the extra ``results``.

    Raises:
        ImportError: it is not installed.
    """
    try:
        return __import__(module)
    except ImportError as error:
        raise ImportError(
            f"{module} is needed for this and is not installed: "
            "pip install 'rollkane[results]'"
        ) from error


def _variables(
    motion: AbstractMotion, names: tuple[str, ...], path: tuple[int, ...]
) -> dict[str, Array]:
    of: Any = motion.rolling_body(*path) if path else motion
    return {name: getattr(of, name) for name in names}


_of_few, _of_many = for_one_call(_variables), for_many_numbers(_variables)


def _values(
    motion: AbstractMotion, names: tuple[str, ...], path: tuple[int, ...] = ()
) -> dict[str, Array]:
    """All variables in one program: parts that they share are computed once.

    Of the body that rolls in it, where a path to one is given.
    """
    states: Any = motion
    # an orientation has four numbers, and little has more
    outputs = max(np.size(x) for x in jax.tree.leaves(states.state)) // 4
    return (_of_many if outputs > _MANY else _of_few)(motion, names, path)


def _lanes(trajectory: Trajectory) -> tuple[str, ...]:
    count = trajectory.code.ndim
    return ("lane",) if count == 1 else tuple(f"lane_{i}" for i in range(count))


def labels(long_name: str, units: str, axes: str) -> dict[str, str]:
    """Attributes of a variable; what is empty is left out."""
    every = {"long_name": long_name, "units": units, "axes": axes}
    return {name: text for name, text in every.items() if text}


def _ends(trajectory: Trajectory) -> dict[str, np.ndarray]:
    names = ("code", "steps", "rejected_steps", "final_time")
    return {name: np.asarray(getattr(trajectory, name)) for name in names}


def _contact(scene: Scene) -> str:
    """What the body does at its contact, for a title."""
    if isinstance(scene, HybridScene):
        return "changes between rolling, slipping and flight"
    return "slips" if scene.contact.slips else "rolls without slipping"
