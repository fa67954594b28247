"""What happened in a run, by kind of scene: lines of its summary.

Only what the outputs and the located changes of the contact tell.
"""

from itertools import pairwise

import numpy as np

from ..geometry.numpy_rotations import rotated
from ..geometry.surfaces import DiscEdge, Ring, Torus
from ..hybrid.modes import Mode
from ..simulation.trajectory import Trajectory
from ..validation.codes import Code
from .motion_samples import MotionSamples

DOES = {Mode.ROLLING: "rolls", Mode.SLIPPING: "slips", Mode.FLYING: "flies"}
_RIMS = DiscEdge, Ring, Torus


def what_happened(trajectory: Trajectory, motion: MotionSamples) -> list[str]:
    """Of a body like a disc, on a base that moves, with masses inside.

    Args:
        trajectory: One run.
        motion: What it reached.

    Returns:
        Lines: the least tilt of a disc or ring, between its plane and the base's [deg],
        and when it fell flat [s]; how far the contact came on a base that moves, and
        carried masses in the body [m].
    """
    lines: list[str] = []
    if isinstance(trajectory.scene.body.surface, _RIMS):
        lines += _tilt_line(motion)
        if int(trajectory.code) == Code.SURFACE_EDGE:
            when = float(trajectory.final_time)
            lines.append(line("fell flat", f"t = {when:.6g} s"))
    touching = motion.rows(motion.touches)
    if motion.base_moves and touching.time.size:
        places = touching.contact_on_base
        far = np.linalg.norm(places - places[0], axis=1)
        lines.append(line("over the base", _farthest(touching.time, far)))
    if motion.masses.size:
        places = motion.carried_centers
        distance = np.linalg.norm(places - places[0], axis=2)
        which = int(np.argmax(np.max(distance, axis=0)))
        name = f"carried mass {which}" if places.shape[1] > 1 else "carried mass"
        text = _farthest(motion.time, distance[:, which])
        lines.append(line(name, f"{text}, in the body"))
    return lines


def mode_line(trajectory: Trajectory) -> list[str]:
    """How long a run rolled, slipped and flew in all [s], where its contact changed."""
    switches = trajectory.switches
    if switches is None or not int(switches.count):
        return []
    count = int(switches.count)
    ends = [float(trajectory.time[0]), *np.asarray(switches.time)[:count].tolist()]
    ends.append(float(trajectory.final_time))
    modes = [switches.before[0], *np.asarray(switches.after)[:count]]
    total = dict.fromkeys(DOES, 0.0)
    for mode, (begin, end) in zip(modes, pairwise(ends), strict=True):
        total[Mode(int(mode))] += abs(end - begin)
    told = [f"{DOES[mode]} {lasted:.4g} s" for mode, lasted in total.items() if lasted]
    return [line("", f"in all {', '.join(told)}")]


def work_line(trajectory: Trajectory, motion: MotionSamples) -> str:
    """How the energy changed [J] where none has to be kept, and by what."""
    scene, switches = trajectory.scene, trajectory.switches
    causes = ["the base"] if motion.base_moves else []
    parts = *scene.supported, *scene.loads, scene.contact
    if any(part.does_work for part in parts):
        causes.append("forces that do work")
    if switches is not None:
        before, after = np.asarray(switches.before), np.asarray(switches.after)
        if Mode.SLIPPING in [*np.asarray(trajectory.mode), *after]:
            causes.append("friction")
        if Mode.FLYING in before:
            causes.append("landings")
    change = f"{motion.energy[0]:.6g} -> {motion.energy[-1]:.6g} J"
    why = f"by {', '.join(causes)}" if causes else "nothing did work"
    return line("energy", f"{change}, {why}")


def path_line(time: np.ndarray, places: np.ndarray) -> str:
    """Length of a contact's path, by chords between outputs, and how far it came.

    Args:
        time: Of the outputs [s], shape (T,).
        places: On the surface's own axes [m], shape (T, 3).
    """
    length = float(np.sum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    far = _farthest(time, np.linalg.norm(places - places[0], axis=1))
    return line("  contact path", f"{length:.4g} m long (chords), {far}")


def line(name: str, text: str) -> str:
    """A line of a summary."""
    return f"  {name:<18}{text}"


def _tilt_line(motion: MotionSamples) -> list[str]:
    motion = motion.rows(motion.touches)  # a tilt to the base is one at the contact
    if not motion.time.size:
        return []
    axis = rotated(motion.orientation, np.array([0.0, 0.0, 1.0]))
    along = np.abs(np.sum(axis * motion.outward, axis=1))
    across = np.linalg.norm(np.cross(axis, motion.outward), axis=1)
    tilt = np.degrees(np.arctan2(across, along))
    least = int(np.argmin(tilt))
    text = f"{tilt[least]:.4g} deg to the base, t = {motion.time[least]:.4g} s"
    return [line("least tilt", text)]


def _farthest(time: np.ndarray, distance: np.ndarray) -> str:
    most = int(np.nanargmax(distance))
    return f"{distance[most]:.4g} m from its start at most, t = {time[most]:.4g} s"
