"""What identifies a study: its programs and numbers, not its source's text or place."""

import hashlib
import re
from collections.abc import Iterable
from typing import Any, cast

import equinox as eqx
import jax
import jax.extend as jex
import jax.numpy as jnp
import numpy as np

from .. import __version__
from ..dynamics.rolling import rolling_derivative
from .study import Study
from .unit_runs import value_of

# where an object lies in memory says nothing of what it is
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")


def fingerprint(study: Study) -> dict[str, Any]:
    """Digests of all that members depend on, by what it is.

    Two studies have the same where their members are the same: functions count by the
    programs that JAX makes of them, with every number that they close over.

    Args:
        study: The study; its functions are traced.
    """
    middle = jnp.full(study.draws.dimension, 0.5)
    options = dict(study.options)
    solver = options.pop("solver")
    options["solver"] = None if solver is None else type(solver).__name__

    def member(u: Any) -> tuple[Any, Any, Any]:
        scene, start = study.make(cast(Any, study.draws.draw(u)))
        return scene, jnp.zeros((), start.angular_velocity.dtype), start

    def moved(u: Any) -> Any:
        scene, t, start = member(u)
        return jax.tree.leaves((scene, start)), rolling_derivative(scene, t, start)

    def seen(u: Any) -> Any:
        either = study.observe | study.series
        scene, t, state = member(u)
        return {name: jnp.asarray(f(scene, t, state)) for name, f in either.items()}

    def happens(u: Any) -> Any:
        scene, t, state = member(u)
        return [value_of(e, None, scene, t, state) for e in _events(study)]

    return {
        "distributions": study.draws.spec(),
        "times": _of_bytes([study.times.tobytes()]),
        "scene and start": _of_program(moved, middle),
        "observables": [*study.observe, "/", *study.series, _of_program(seen, middle)],
        "events": [
            *[(*_kept(e), e in study.stop) for e in _events(study)],
            _of_program(happens, middle),
        ],
        "modes": _of_tree(study.modes),
        "ends": list(study.ends),
        "options": options,
        "precision": str(np.dtype(jnp.result_type(float))),
        "versions": {"rollkane": __version__, "jax": jax.__version__},
    }


def _events(study: Study) -> list[Any]:
    return [*study.events, *study.stop]


def _kept(event: Any) -> tuple[Any, ...]:
    return event.name, event.direction, event.stop, event.most


def _of_tree(tree: Any) -> str:
    leaves, structure = cast("tuple[list[Any], Any]", jax.tree.flatten(tree))
    text = _ADDRESS.sub("", f"{structure} {eqx.tree_pformat(tree)}")
    return _of_bytes([text.encode(), *map(_bytes, leaves)])


def _of_program(function: Any, *arguments: Any) -> str:
    program = jax.make_jaxpr(function)(*arguments)
    text = _ADDRESS.sub("", str(program.jaxpr))
    return _of_bytes([text.encode(), *map(_bytes, _constants(program))])


def _constants(program: Any) -> Iterable[Any]:
    """Numbers that a program and those inside of it close over."""
    yield from program.consts
    for equation in program.jaxpr.eqns:
        for value in equation.params.values():
            several = isinstance(value, (tuple, list))
            for part in cast("tuple[Any, ...]", value) if several else (value,):
                if isinstance(part, jex.core.ClosedJaxpr):
                    yield from _constants(part)
                elif isinstance(part, jex.core.Jaxpr):
                    yield from _constants(jex.core.ClosedJaxpr(part, ()))


def _bytes(number: Any) -> bytes:
    array = np.asarray(number)
    return f"{array.dtype}{array.shape}".encode() + array.tobytes()


def _of_bytes(parts: Iterable[bytes]) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(part)
    return found.hexdigest()
