"""Many motions at once: in blocks, on all cores, in memory that is the block's."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import diffrax as dfx
from jaxtyping import Array

from ..dynamics.scene import Scene
from ..hybrid.modes import Modes
from ..kinematics.coordinates import State
from ..validation.checks import FieldError
from .ensemble_result import Ensemble, joined
from .ensemble_run import EnsembleRun
from .motion import Observable


def ensemble(
    scene: Scene | Sequence[Scene] | Callable[[Array], Scene],
    starts: State | Sequence[State] | Callable[[Array], State],
    times: Any,
    *,
    observe: Observable | None = None,
    keep_states: bool | None = None,
    count: int | None = None,
    scene_axes: Any = None,
    rtol: float | None = None,
    atol: float | None = None,
    solver: dfx.AbstractSolver[Any] | None = None,
    modes: Modes | None = None,
    max_steps: int | None = None,
    method: str = "auto",
    block: int | None = None,
    workers: int | None = None,
    events: Any = (),
    stop: Any = None,
    second_contact: bool = False,
) -> Ensemble:
    """Motions of many members: starts, scenes, or both differ.

    The steps are those of :func:`rollkane.simulate`; a member that cannot go on ends
    with a code of its own and disturbs no other. On a CPU the right-hand side is
    compiled together with a loop in which every lane of the processor's vectors
    follows its own motion at its own step size; what that loop does not have (modes,
    records that differ, arguments that are traced) runs as ``simulate`` under
    ``jax.vmap``, natively where that can.

    Args:
        scene: Scene; every number of it may have an axis of N members in front, as
            ``jax.vmap`` of a function that makes scenes gives it. Or such a function
            of the member's number, called block by block; or a list of scenes.
        starts: States, from ``jax.vmap`` of :func:`rollkane.place`, a list of them, or
            a function of the member's number; a single one is shared by all.
        times: Output times [s], shape (T,), T >= 2, those of all members; only the
            first and the last where no more is wanted.
        observe: ``observe(scene, t, state)`` -> tree of arrays, kept at the times
            instead of the states, such as those of ``rollkane.dynamics.observables``.
        keep_states: Whether to keep the states at the times, of which ``position`` and
            all the rest is computed; left out, where nothing is observed.
        count: N, where functions of the member's number do not tell.
        scene_axes: As ``in_axes`` of ``jax.vmap``, for scenes whose own functions have
            parameters that differ; found out otherwise.
        rtol: As in ``simulate`` [1].
        atol: As in ``simulate`` [unit of the state].
        solver: diffrax solver; by default Dopri8 below rtol 1e-6, else Tsit5.
        modes: How runs may change between rolling, slipping and flight; numbers may
            have the axis of members, as ``jax.vmap`` of :class:`Modes` makes it.
        max_steps: Most steps of a member; 4194304 by default.
        method: ``"native"``, ``"diffrax"``, or ``"auto"``: native where it can.
        block: Members that are worked on together; by default as many as keep outputs
            of 32 MiB, at most 8192.
        workers: Threads; as many as processors by default.
        events: As in ``simulate``, the same for all members.
        stop: Likewise: a member that ends leaves its place to the next.
        second_contact: Whether a member ends, with ``Code.SECOND_CONTACT``, where it
            reaches its base at a second place, as in ``simulate``.

    Returns:
        The ensemble. Where an argument is traced (``jax.grad``, ``jax.jit``), it is
        made of JAX arrays and can be differentiated.

    Raises:
        FieldError: bad input, or a method that cannot do what is asked.
    """
    run = EnsembleRun(
        *(scene, starts, times, observe, keep_states, count, scene_axes, rtol, atol),
        *(solver, modes, max_steps, method, block, workers, events, stop),
        second_contact,
    )
    if run.traced:
        return run.whole()
    return joined(list(run.blocks()), run.members.given_scene)


def ensemble_blocks(
    scene: Scene | Sequence[Scene] | Callable[[Array], Scene],
    starts: State | Sequence[State] | Callable[[Array], State],
    times: Any,
    **options: Any,
) -> Iterator[Ensemble]:
    """An ensemble block by block, as it is computed: memory is that of a few blocks.

    Args:
        scene: As in :func:`ensemble`.
        starts: As in ``ensemble``; a function of the member's number where even the
            starts would fill the memory.
        times: Output times [s], shape (T,).
        options: Those of ``ensemble``.

    Yields:
        Ensembles of the members in order, each with ``first``, the number of its
        first member.

    Raises:
        FieldError: as ``ensemble``; traced arguments.
    """
    run = EnsembleRun(scene, starts, times, **options)
    if run.traced:
        raise FieldError(
            "ensemble_blocks", "a traced value", "cannot stream", "call ensemble"
        )
    return run.blocks()
