"""Sensitivities of a motion: derivatives of what is observed by parameters."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..codegen.compile_effort import for_many_numbers, for_one_call
from ..dynamics.scene import Scene, require_scene
from ..hybrid.modes import Modes
from ..integration.backends import may_go_natively
from ..integration.integrate import checked_times
from ..kinematics.coordinates import State
from ..kinematics.voronets import AnyState
from ..simulation.run import simulate
from ..simulation.run_checks import check_span
from ..simulation.run_options import RunOptions
from ..validation.checks import FieldError
from .layout import Coordinates, Layout
from .parameters import Free, Model, located, with_numbers

Observable = Callable[[Scene, Array, AnyState], Array]


@dataclasses.dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives along a run.

    Attributes:
        time: Output times [s], shape (T,).
        observed: What was observed, by name, shape (T, ...).
        names: Of the parameters' numbers, by path: independent ones (six of an
            inertia, small rotations about fixed axes [rad] of a quaternion).
        values: By observable, then path: derivatives [unit of the observable / unit of
            the parameter], shape (T, ..., n).
        code: Of the run; what it did not reach is NaN.
    """

    time: np.ndarray
    observed: dict[str, np.ndarray]
    names: dict[str, tuple[str, ...]]
    values: dict[str, dict[str, np.ndarray]]
    code: int

    def to_xarray(self) -> Any:
        """As an ``xarray.Dataset`` (extra ``results``): one variable a pair."""
        from ..files.sensitivity_dataset import sensitivity_dataset

        return sensitivity_dataset(self)

    def plot(self, path: Any = None) -> Any:
        """Derivatives against time, a row for each observable (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_sensitivity import plot_sensitivity

        return plot_sensitivity(self, path)


def sensitivity(
    scene: Scene,
    start: State,
    times: Any,
    free: Free | str | Sequence[Free | str],
    observe: Mapping[str, Observable],
    *,
    modes: Modes | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    max_steps: int | None = None,
    method: str = "auto",
) -> Sensitivity:
    """Derivatives of observables along a run by parameters, in forward mode.

    Args:
        scene: The model.
        start: State at ``times[0]``.
        times: Output times [s], shape (T,), increasing.
        free: Parameters: paths, or :class:`rollkane.Free` (of which path and form
            matter).
        observe: By name, ``function(scene, t, state)`` -> a number or an array.
        modes: How the contact may change in the run.
        rtol: Relative tolerance of the run [1]; see :func:`rollkane.simulate`.
        atol: Absolute tolerance.
        max_steps: Most steps of the run.
        method: Of the run.

    Returns:
        Observables and derivatives.

    Raises:
        FieldError: paths that lead nowhere, nothing to observe.
    """
    chosen = [free] if isinstance(free, (str, Free)) else list(free)
    wanted = [Free(one) if isinstance(one, str) else one for one in chosen]
    require_scene("sensitivity.scene", scene)
    named: list[Any] = list(getattr(observe, "values", list)())
    if not named or not all(map(callable, named)):
        remedy = 'give {"energy": function(scene, t, state)}'
        raise FieldError("sensitivity.observe", observe, "names no functions", remedy)
    known = checked_times(times, start.angular_velocity.dtype)
    check_span(scene, known)
    model = Model(scene, start, jnp.asarray(known[0]), modes, {})
    entries = Layout([model], wanted).entries
    options = RunOptions(rtol, atol, max_steps, method)
    functions = tuple(sorted(observe.items()))
    transforms = tuple(entry.transform for entry in entries)
    keys = tuple(located(entry.free.path, {}) for entry in entries)
    changes = tuple(jnp.zeros(len(e.transform.labels())) for e in entries)
    program = _beside_c if may_go_natively(method) else _by_xla
    found, slopes, code = program(
        functions, keys, options, model, transforms, jnp.asarray(known), changes
    )
    return Sensitivity(
        time=np.asarray(known),
        observed={name: np.asarray(value) for name, value in found.items()},
        names={e.free.path: _names(e) for e in entries},
        values={
            name: {
                entry.free.path: np.asarray(slope)
                for entry, slope in zip(entries, own, strict=True)
            }
            for name, own in slopes.items()
        },
        code=int(code),
    )


def _names(entry: Coordinates) -> tuple[str, ...]:
    return tuple(entry.free.path + label for label in entry.transform.labels())


def _derivatives(
    functions: tuple[tuple[str, Observable], ...],
    keys: tuple[tuple[str | int, ...], ...],
    options: RunOptions,
    model: Model,
    transforms: Any,
    times: Array,
    changes: tuple[Array, ...],
) -> tuple[dict[str, Array], dict[str, tuple[Array, ...]], Array]:
    """Observables, their derivatives by the changes, and the run's code."""

    def observed(changes: tuple[Array, ...]) -> tuple[dict[str, Array], Any]:
        values = [t.changed(c) for t, c in zip(transforms, changes, strict=True)]
        changed = with_numbers(model, zip(keys, values, strict=True))
        run = simulate(
            changed.scene,
            changed.start,
            times,
            modes=changed.modes,
            **options._asdict(),
        )
        found = {name: run.each(function) for name, function in functions}
        return found, (found, run.code)

    slopes, (found, code) = cast(
        tuple[dict[str, tuple[Array, ...]], tuple[dict[str, Array], Array]],
        jax.jacfwd(observed, has_aux=True)(changes),
    )
    return found, slopes, code


_beside_c, _by_xla = for_one_call(_derivatives), for_many_numbers(_derivatives)
