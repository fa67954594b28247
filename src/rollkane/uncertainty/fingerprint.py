"""What identifies a study: its programs and numbers, not its source's text or place."""

from collections.abc import Mapping
from typing import Any, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import __version__
from ..hybrid.modes import modes_of
from ..validation.program_digest import (
    bytes_of_array,
    digest_of_bytes,
    digest_of_program,
)
from .made_members import made
from .moded_views import rates, state_at, value_of
from .study import Observable, Study


def fingerprint(study: Study) -> dict[str, Any]:
    """Digests of all that members depend on, by what it is.

    Two studies have the same where their members are the same: functions count by the
    programs that JAX makes of them, with every number that they close over.

    Args:
        study: The study; its functions are traced.
    """
    middle = jnp.full(study.draws.dimension, 0.5)
    t = jnp.asarray(study.times[0])
    options = dict(study.options)
    solver = options.pop("solver")
    options = {name: _plain(value) for name, value in options.items()}
    options["solver"] = None if solver is None else _of_solver(solver)

    def member(u: Any) -> tuple[Any, Any]:
        return made(study.make, cast(Any, study.draws.draw(u)), study.modes)

    def moved(u: Any, t: Any) -> Any:
        scene, start = member(u)
        surfaces = scene.body.surface, scene.base.surface
        ends = [one.extent(jnp.zeros(one.coordinate_count)) for one in surfaces]
        own: Any = scene
        if study.modes is not None:  # told apart by themselves
            own = eqx.tree_at(lambda s: s.modes, scene, None)
        leaves = jax.tree.leaves((own, start))
        return leaves, ends, rates(scene, t, start)

    def seen(functions: Mapping[str, Observable]) -> str:
        def values(u: Any, t: Any) -> Any:
            scene, start = member(u)
            how = scene, t, state_at(scene, start)
            return [value_of(f, *how) for f in functions.values()]

        return digest_of_program(values, middle, t)

    events = [*study.events, *study.stop]
    return {
        "distributions": study.draws.spec(),
        "times": digest_of_bytes([bytes_of_array(study.times)]),
        "scene and start": digest_of_program(moved, middle, t),
        "observables": [
            *(*study.observe, "/", *study.series),
            seen(study.observe | study.series),
        ],
        "events": [
            *[_kept(e, i >= len(study.events)) for i, e in enumerate(events)],
            seen({str(i): event for i, event in enumerate(events)}),
        ],
        "modes": _of_tree(modes_of(member(middle)[0])),
        "ends": list(study.ends),
        "options": options,
        "precision": str(np.dtype(jnp.result_type(float))),
        "versions": {"rollkane": __version__, "jax": jax.__version__},
    }


def without_programs(found: Mapping[str, Any]) -> dict[str, Any]:
    """A fingerprint less the digests that hold the distributions' numbers, too.

    Where two have other distributions, nobody knows whether the functions differ, too.

    Args:
        found: What :func:`fingerprint` gives, or JSON keeps of it.
    """
    traced = {n: list(found.get(n, ()))[:-1] for n in ("observables", "events")}
    return {**found, **traced, "scene and start": None}


def _kept(event: Any, stops: bool) -> list[Any]:
    return [event.name, event.direction, event.stop or stops, event.most]


def _of_tree(tree: Any) -> str:
    """Of numbers and of what is static."""
    leaves, structure = cast("tuple[list[Any], Any]", jax.tree.flatten(tree))
    return digest_of_bytes([str(structure).encode(), *map(bytes_of_array, leaves)])


def _of_solver(solver: dfx.AbstractSolver[Any]) -> str:
    """A method's name, with the digest of its coefficients and of what it holds."""
    tableau: Any = getattr(solver, "tableau", None)
    numbers: list[Any] = [] if tableau is None else [*vars(tableau).values()]
    held = filter(eqx.is_array_like, jax.tree.leaves((numbers, solver)))
    digest = digest_of_bytes(map(bytes_of_array, held))
    return f"{type(solver).__name__} {digest[:16]}"


def _plain(value: Any) -> Any:
    """A number as JSON has it."""
    return value.tolist() if hasattr(value, "tolist") else value
