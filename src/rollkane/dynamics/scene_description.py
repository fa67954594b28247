"""A scene in sentences: what rolls on what, under which loads, and what is kept."""

from typing import Any

import numpy as np

from ..validation.checks import is_traced
from ..validation.shown import in_a_line


def description(scene: Any) -> str:
    """What ``Scene.describe`` gives.

    Args:
        scene: The scene.
    """
    if is_traced(scene):
        return repr(scene)
    lines = [_body(scene.body), _contact(scene), _base(scene.base)]
    lines += [f"It carries {in_a_line(part)}." for part in scene.supported]
    loads = [in_a_line(load) for load in scene.loads]
    lines.append(f"Loads: {'; '.join(loads) or 'none'}.")
    count = scene.coordinate_count
    inner = f", and {count} coordinates of what it carries" if count else ""
    lines.append(
        f"Three angular velocities change by the equations of motion{inner}; "
        + _kept(scene)
    )
    return "\n".join(lines)


def _body(body: Any) -> str:
    moments = np.linalg.eigvalsh(np.asarray(body.inertia, float))
    center = np.asarray(body.center_of_mass, float)
    told = ", ".join(f"{x:.4g}" for x in moments)
    where = "at the body origin"
    if np.any(center):
        where = f"at ({', '.join(f'{x:.4g}' for x in center)}) m on body axes"
    return (
        f"A body of {float(body.mass):.4g} kg with the surface "
        f"{in_a_line(body.surface)}, its mass centre {where}, "
        f"principal moments of inertia {told} kg m^2."
    )


def _contact(scene: Any) -> str:
    law = scene.contact
    if law.slips:
        return f"It slips on its base against {in_a_line(law.friction)}."
    if getattr(law, "without_spin", False):
        return "It rolls on its base without slipping and without spin."
    return "It rolls on its base without slipping; the contact may pull."


def _base(base: Any) -> str:
    how = "at rest" if base.motion is None else f"moving by {in_a_line(base.motion)}"
    return f"The base is {in_a_line(base.surface)}, {how}."


def _kept(scene: Any) -> str:
    if scene.does_work:
        return "forces that do work change the energy."
    if scene.base.motion is None:
        return "the energy is kept."
    return "the base moves, and may do work on the body."
