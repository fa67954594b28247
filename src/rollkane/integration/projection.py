"""Steps projected onto the invariants of a motion."""

# equinox lets a property stand for an abstract field
# pyright: reportIncompatibleVariableOverride=false
# pyright: reportIncompatibleMethodOverride=false

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, TypeAlias, cast

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..dynamics.abstract_supported import refuse_rolling_parts
from ..dynamics.observables import energy, kinetic_energy
from ..dynamics.scene import Scene, require_scene
from ..kinematics.coordinates import State, pack, unpack
from ..validation.checks import FieldError
from .controller_interface import Number
from .diffrax_checks import check_kinds

# What a step of a diffrax solver gives: its end, the error, what interpolates, memory.
_Step: TypeAlias = tuple[Array, Array | None, dict[str, Any], Any, dfx.RESULTS]


class _Corrected(dfx.AbstractLocalInterpolation):
    """A solver's interpolation, which ends where the step was projected to."""

    kind: Callable[..., dfx.AbstractLocalInterpolation] = eqx.field(static=True)
    dense: Any
    change: Float[Array, " y"]
    t0: Any
    t1: Any

    def evaluate(
        self, t0: Number, t1: Number | None = None, left: bool = True
    ) -> Float[Array, " y"]:
        """At a time; the difference of two times where both are given."""
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        inner: Any = self.kind(t0=self.t0, t1=self.t1, **self.dense)
        span = self.t1 - self.t0
        share = jnp.where(span == 0.0, 1.0, (t0 - self.t0) / span)
        return inner.evaluate(t0, left=left) + share * self.change


class Projected(dfx.AbstractWrappedSolver[Any]):
    """A solver whose every step is projected onto a manifold.

    Attributes:
        solver: A diffrax solver.
        like: Sizes of the state; set by ``simulate``.
    """

    solver: dfx.AbstractSolver[Any]
    like: Any = eqx.field(static=True, default=None)

    @property
    def term_structure(self) -> Any:
        """That of the solver."""
        return cast(Any, self.solver).term_structure

    @property
    def interpolation_cls(self) -> Callable[..., _Corrected]:
        """That of the solver, and what was projected."""
        return functools.partial(_Corrected, self.solver.interpolation_cls)

    @property
    def term_compatible_contr_kwargs(self) -> Any:
        """That of the solver."""
        return cast(Any, self.solver).term_compatible_contr_kwargs

    @property
    def scan_kind(self) -> Any:
        """That of the solver."""
        return getattr(self.solver, "scan_kind", None)

    def order(self, terms: Any) -> int | None:
        """That of the solver."""
        return self.solver.order(terms)

    def strong_order(self, terms: Any) -> Number | None:
        """That of the solver."""
        return self.solver.strong_order(terms)

    def error_order(self, terms: Any) -> Number | None:
        """That of the solver."""
        return self.solver.error_order(terms)

    def init(self, terms: Any, t0: Number, t1: Number, y0: Any, args: Any) -> Any:
        """That of the solver."""
        return self.solver.init(terms, t0, t1, y0, args)

    def func(self, terms: Any, t0: Number, y0: Any, args: Any) -> Any:
        """That of the solver."""
        return cast(Any, self.solver).func(terms, t0, y0, args)

    def advanced(
        self,
        terms: Any,
        t0: Number,
        t1: Number,
        y0: Any,
        args: Any,
        memory: Any,
        keep: Callable[[Any], Any],
    ) -> _Step:
        """A step of the solver, its end projected by a function of the state."""
        # rates that the solver remembers from its own end would be slightly others
        made_jump = True
        stepped: _Step = cast(
            Any, self.solver.step(terms, t0, t1, y0, args, memory, made_jump)
        )
        y1, error, dense, memory, result = stepped
        kept = pack(keep(unpack(y1, self.like)))
        return kept, error, {"dense": dense, "change": kept - y1}, memory, result

    def of(self, like: Any) -> "Projected":
        """For states of known sizes."""
        return dataclasses.replace(self, like=like)


class Keeping(Projected):
    """A solver whose every step ends on the integrals of the motion.

    For long runs and for motions next to a separatrix, where the rounding of one step
    decides when the next turn comes. What is kept, and how, is the user's to know.

    Attributes:
        solver: A diffrax solver.
        keep: ``keep(state)`` -> the state that the motion can have: a function of
            ``State`` or ``KaneState`` that moves it by no more than the error of a
            step. Its constants are fixed; derivatives pass through it.
        like: Sizes of the state; set by ``simulate``.
    """

    keep: Callable[[Any], Any] = eqx.field(static=True, kw_only=True)

    def __init__(
        self,
        solver: dfx.AbstractSolver[Any],
        keep: Callable[[Any], Any],
        like: Any = None,
    ):
        """Make one of a solver and a function of the state (see the class)."""
        self.solver, self.keep, self.like = solver, keep, like

    def step(
        self,
        terms: Any,
        t0: Number,
        t1: Number,
        y0: Any,
        args: Any,
        solver_state: Any,
        made_jump: Any,
    ) -> _Step:
        """A step of the solver, projected."""
        del made_jump
        return self.advanced(terms, t0, t1, y0, args, solver_state, self.keep)


class KeepingEnergy(Projected):
    """A solver whose every step ends on the energy with which its run began.

    The energy is that of the scene which is run, at its own first state.

    Attributes:
        solver: A diffrax solver.
        like: Sizes of the state; set by ``simulate``.
    """

    def init(self, terms: Any, t0: Number, t1: Number, y0: Any, args: Any) -> Any:
        """That of the solver, and the energy [J] at the beginning."""
        memory = self.solver.init(terms, t0, t1, y0, args)
        return memory, energy(args, cast(Array, t0), unpack(y0, self.like))

    def step(
        self,
        terms: Any,
        t0: Number,
        t1: Number,
        y0: Any,
        args: Any,
        solver_state: Any,
        made_jump: Any,
    ) -> _Step:
        """A step of the solver, projected by scaling the angular velocity."""
        del made_jump
        memory, wanted = solver_state
        keep = functools.partial(_with_energy, args, cast(Array, t1), wanted)
        stepped = self.advanced(terms, t0, t1, y0, args, memory, keep)
        y1, error, dense, memory, result = stepped
        return y1, error, dense, (memory, wanted), result


def _with_energy(
    scene: Scene, t: Float[Array, ""], wanted: Float[Array, ""], state: State
) -> State:
    """The state, its angular velocity scaled to an energy [J]."""
    moving = kinetic_energy(scene, t, state)
    resting = energy(scene, t, state) - moving
    scale = jnp.sqrt((wanted - resting) / moving)
    turned = scale * state.angular_velocity
    return eqx.tree_at(lambda s: s.angular_velocity, state, turned)


def keeping_energy(
    scene: Scene,
    start: State | None = None,
    solver: dfx.AbstractSolver[Any] | None = None,
) -> KeepingEnergy:
    """A solver whose every step ends on the energy [J] with which its run began.

    The angular velocity is scaled by what the step's error asks for.

    Args:
        scene: One that keeps its energy; that which is run must do so, too.
        start: Not used: the energy is that of the start which is run. The body must
            move there.
        solver: A diffrax solver; ``Dopri8()`` when left out.

    Raises:
        FieldError: a scene whose energy may change, or that carries coordinates.
    """
    del start
    check_keeps_energy("keeping_energy.scene", scene)
    check_kinds("keeping_energy", solver=solver)
    return KeepingEnergy(dfx.Dopri8() if solver is None else solver)


def check_keeps_energy(field: str, scene: Scene) -> None:
    """Refuse a scene whose energy may change, or that carries coordinates.

    Raises:
        FieldError: it does.
    """
    require_scene(field, scene)
    refuse_rolling_parts(field, scene.supported)
    if scene.does_work or scene.base.motion is not None or scene.coordinate_count:
        raise FieldError(
            field,
            scene,
            "does not keep its energy, or carries coordinates",
            "leave out what does work, or write the function for Keeping yourself",
        )
