"""Why a run ended: its code, and the field at fault where a number cannot be used.

A traced number that a check refuses becomes NaN (:mod:`rollkane.validation.checks`);
here a run finds which of its numbers it is, so that it can end with a code and name the
field.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, SupportsInt, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int

# Numbers of an array that are looked at with those of all others: a record's are not.
_FEW = 64


class Code:
    """Why a run ended: values of ``Trajectory.code``."""

    COMPLETED = 0
    MAX_STEPS = 1
    STEP_TOO_SMALL = 2
    BAD_START = 3
    SOLVER_STOPPED = 4
    CHART_EDGE = 5
    PAINLEVE = 6
    TOO_MANY_SWITCHES = 7
    BAD_SCENE = 8
    SURFACE_EDGE = 9
    SECOND_CONTACT = 10
    INCONSISTENT_IMPACT = 11
    STOPPED = 12
    EVENT_NOT_FINITE = 13
    INTERRUPTED = 14
    NEITHER_GRIPS_NOR_SLIPS = 15
    NO_LONGER_REDUNDANT = 16
    DEPENDENT_SPEEDS = 17


_REASONS = {
    Code.COMPLETED: "completed",
    Code.MAX_STEPS: "the largest number of steps was reached: raise max_steps, or "
    "loosen rtol",
    Code.STEP_TOO_SMALL: "the step became too small for the clock: the motion reached "
    "a singular place (surfaces that fit each other), a function of yours gave NaN "
    "there, or times so far from zero (seconds since 1970) have no shorter step; look "
    "at final_time and final_state",
    Code.BAD_START: "the start cannot be used: a number in it or in the times is NaN, "
    "the times are not in order, or the first rates are not finite",
    Code.CHART_EDGE: "the contact came to the edge of a surface's chart, where "
    'Voronets coordinates end: go on from final_state with coordinates="pole-free", '
    "or with another chart",
    Code.PAINLEVE: "no normal force fits the friction here (Painleve's paradox): the "
    "body jams or jumps, which this contact law does not have; lower the friction (a "
    "body that never slips has no end of it: give Modes(friction=)), or look at "
    "final_state with rollkane.dynamics.rolling.painleve_margin",
    Code.TOO_MANY_SWITCHES: "the contact changed more often than Modes(switches=) "
    "keeps: raise it, or rest_speed if the body comes to rest by ever smaller "
    "rebounds; if it ended and began again at once, by a viscous resistance, which "
    "does not vanish with the normal force: give dry= instead",
    Code.SOLVER_STOPPED: "the integrator stopped of itself; look at final_time, "
    "final_state",
    Code.BAD_SCENE: "the scene cannot be used: a number in it is NaN",
    Code.SURFACE_EDGE: "the contact, or the nearest point of a flight, came to where a "
    "surface ends or has no tangent plane: the flat of a disc, which comes to lie on "
    "its face (a Ring is a wire, and its contact goes round on a curved base), the tip "
    "of a cone, the rim of a cup, the pole of a chart (a Parametric of_direction has "
    "none); look at final_time and final_state",
    Code.SECOND_CONTACT: "the body reached the base at a second place, or at several "
    "at once; look at final_time and final_state, or leave out second_contact, if it "
    "was asked for, to go on through it",
    Code.INCONSISTENT_IMPACT: "Newton's restitution with friction has no impulse for "
    "this impact that pushes, acts against the slip and adds no energy: use "
    'Modes(impact="energetic")',
    Code.STOPPED: "an event with stop=True ended the run",
    Code.EVENT_NOT_FINITE: "an event's function gave NaN: nothing is known of it from "
    "final_time and final_state on",
    Code.NEITHER_GRIPS_NOR_SLIPS: "rubber has no motion here: to roll without a spin, "
    "or to end the spin with which it grips, its contact would have to pull or needs "
    "more friction than there is, and free to spin it is held by less; use Rolling(), "
    "or more friction",
    Code.NO_LONGER_REDUNDANT: "a constraint that followed from the others at the "
    "start, and was left out, does not follow from them any more: the motion up to "
    "here is right, and from here on the contacts leave less free, or nothing; go on "
    "with kane.rolling_contacts from where it counts, or leave out a contact",
    Code.DEPENDENT_SPEEDS: "the constraints do not determine the speeds that were "
    "chosen as dependent here, and no equations of the others are left: the motion up "
    "to here is right; choose other dependent speeds, or dependent=None, by which a "
    "motion passes unless constraints come to follow from each other here",
    Code.INTERRUPTED: "interrupted: what was reached until then is kept",
}

_NAMES = {
    code: name.lower().replace("_", " ")
    for name, code in vars(Code).items()
    if not name.startswith("_")
}

NO_FAULT = -1
_ASKED = "times", "rtol", "atol", "dt0"  # behind the fields of model and start
_REFUSED = (
    "a check refuses what was given there, or it was NaN; make the same with numbers "
    "that are known (outside of jit, vmap and grad) to see the check's sentence"
)


_Path = tuple[Any, ...]  # keys of JAX's, one behind the other
_Flat = tuple[list[tuple[_Path, Any]], Any]  # leaves with their paths, and a structure


class Fields(NamedTuple):
    """Names of the numbers that a run depends on, in the order in which it checks them.

    Attributes:
        names: Of every array of the model, then of the start.
        of_model: How many of them are the model's.
    """

    names: tuple[str, ...]
    of_model: int

    @staticmethod
    def of(model: Any, start: Any, kind: str = "scene") -> "Fields":
        """Those of a model (a scene, a system) and a start, or of their structures."""
        names: list[str] = []
        for name, tree in ((kind, model), ("start", start)):
            flat = cast("_Flat", jax.tree_util.tree_flatten_with_path(tree))
            names += [name + _shown(path) for path, _ in flat[0]]
        return Fields(tuple(names), len(jax.tree.leaves(model)))

    @property
    def times(self) -> int:
        """Number that stands for the output times."""
        return len(self.names)

    def name_of(self, fault: SupportsInt) -> str:
        """Name of a field by its number; nothing for ``NO_FAULT``."""
        return "" if int(fault) == NO_FAULT else (*self.names, *_ASKED)[int(fault)]

    def reason(self, code: SupportsInt, fault: SupportsInt, event: str = "") -> str:
        """What a code says, with the field at fault.

        Args:
            code: One of :class:`Code`.
            fault: Number of the field, or ``NO_FAULT``.
            event: Name of the event that ended the run, if one did.
        """
        code, fault = int(code), int(fault)
        if fault == NO_FAULT:
            return f'{reason_of(code)}: "{event}"' if event else reason_of(code)
        if fault == self.times:
            return "the times cannot be used: they are not finite or not in order"
        if fault > self.times:
            return f"{self.name_of(fault)} cannot be used: {_REFUSED}"
        what = self.names[fault].partition(".")[0]
        return f"the {what} cannot be used: {self.names[fault]} is NaN: {_REFUSED}"


def _shown(path: _Path) -> str:
    """A path of keys as a user would write it; private fields are left out."""
    shown = [jax.tree_util.keystr((key,)) for key in path]
    return "".join(key for key in shown if not key.startswith("._"))


def first_fault(
    model: Any, start: Any, in_order: Array, steps: Sequence[Any] = ()
) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """The first field that is NaN, and the code of a run with it.

    Args:
        model: Scene or system.
        start: State.
        in_order: Whether the times are finite and in order.
        steps: ``rtol``, ``atol``, ``dt0``, as many as may have been traced.

    Returns:
        The field's number in ``Fields`` (``NO_FAULT``: none) and the code
        (``BAD_START``, too, where it is none).
    """
    model, start = jax.tree.leaves(model), jax.tree.leaves(start)
    flags = [_spoiled(x) for x in (*model, *start)] + [~in_order[None]]
    flags += [_spoiled(x) for x in steps]
    count = len(flags)
    # one pass over all numbers: one for each array takes several microseconds a run
    owners = np.repeat(np.arange(count), [flag.size for flag in flags])
    spoiled = jnp.concatenate(flags)
    first = jnp.min(jnp.where(spoiled, jnp.asarray(owners), count))
    code = jnp.where(first < len(model), Code.BAD_SCENE, Code.BAD_START)
    return jnp.where(first < count, first, NO_FAULT), code


def _spoiled(x: ArrayLike) -> Bool[Array, " n"]:
    """Whether numbers are NaN; of many whether any is."""
    spoiled = jnp.isnan(x).reshape(-1)
    return spoiled if spoiled.size <= _FEW else jnp.any(spoiled)[None]


def is_stuck(code: Any) -> Any:
    """Whether steps became too short for the clock, for a reason still to be found."""
    return (code == Code.STEP_TOO_SMALL) | (code == Code.BAD_START)


def outcome_of(code: SupportsInt, event: str = "", field: str = "") -> str:
    """A code in a word or two, with what it names.

    Args:
        code: One of :class:`Code`.
        event: Name of the event that ended the run, if one did.
        field: Name of the field that cannot be used, if it is one.
    """
    name, what = _NAMES[int(code)], event or field
    return f"{name}: {what}" if what else name


def reason_of(code: SupportsInt) -> str:
    """What a code says, and what to do about it."""
    return _REASONS[int(code)]
