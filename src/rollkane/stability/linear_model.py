"""Linear models with inputs and outputs, in independent coordinates."""

import difflib
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..dynamics.loads import AbstractLoad, Force, Gravity, Torque
from ..dynamics.scene import Scene
from ..dynamics.supported import AbstractSupported, Carried
from ..identification import paths
from ..validation.checks import FieldError
from .independent_coordinates import least_squares
from .problem import AbstractProblem
from .quantities import Quantity, held_quantities
from .refusals import refuse_other_scene
from .steady import SteadyMotion, problem_of

_Inputs = tuple[tuple[str, paths.Keys], ...]
_ACTS = ("base acceleration", "force", "torque")
INPUTS = tuple(f"{act} {axis}" for act in _ACTS for axis in "xyz")


class LinearModel(NamedTuple):
    """``x' = f + A x + B r`` and ``y = y0 + C x + D r`` about a state, which is x = 0.

    Attributes:
        A: Shape (n, n), [1/s] between like quantities.
        B: By the inputs, shape (n, r), [unit of x per s and unit of r].
        C: Of the outputs, shape (m, n), [unit of y per unit of x].
        D: Outputs by inputs, shape (m, r).
        f: Rates of x at the state itself [unit of x / s], shape (n,): zero about a
            steady motion.
        names: Of the independent coordinates x: positions, then velocities.
        inputs: Names of r.
        outputs: Names of y.
    """

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n r"]
    C: Float[np.ndarray, "m n"]
    D: Float[np.ndarray, "m r"]
    f: Float[np.ndarray, " n"]
    names: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw eigenvalues of A (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_spectra import plot_linear_model

        return plot_linear_model(self, path, title)


def linearize(
    scene: Any,
    state: Any,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] | Mapping[str, Any] = (),
) -> LinearModel:
    """The linear model of small motions about a state or a steady motion.

    Args:
        scene: What rolls on what; or a ``rollkane.kane.KaneSystem``.
        state: A state, in axes that the base carries along; or a ``SteadyMotion``, in
            the frame that moves with it. Vectors among inputs and outputs are on the
            axes of that frame: fixed ones at the start, which a base or a steady motion
            that turns carries round.
        inputs: Names of r: "base acceleration x" [m/s^2] (a field against it in the
            base's frame, whose potential an output "energy" has), "force y" at the mass
            centre [N], "torque z" [N m], on those axes; "force alpha[0]", of a
            motor on a coordinate of what is carried [J per its unit]; or a number of
            the scene by its path, such as a spring's force
            ("supported[0].parameters.k").
        outputs: Names of y, as of what ``steady_motion`` holds; coordinates of the
            model by their names; ``{"name": function}`` of ``function(scene, t,
            state)``.

    Returns:
        ``LinearModel`` of NumPy arrays, as control tools take them.

    Raises:
        FieldError: names that nothing has, a scene that depends on time, another scene
            than the steady motion's.

    Source: docs/theory.md, (10.3).
    """
    if isinstance(state, SteadyMotion):
        refuse_other_scene("linearize.scene", scene, state.problem.model)
        problem, at, xi = state.problem, state.state, state.solution.xi
    else:
        problem, at = problem_of(scene, state)
        xi = np.zeros(len(problem.group))
    names, _ = problem.coordinates(at)
    chosen = tuple(_input(problem, name) for name in inputs)
    own = [name for name in outputs if name in names]
    others = outputs
    if isinstance(outputs, Mapping):
        others = {k: v for k, v in outputs.items() if k not in own}
    else:
        others = [k for k in outputs if k not in own]
    quantities, _ = held_quantities("linearize.outputs", problem, at, others)
    size = len(names), len(chosen)
    x, r = np.zeros(size[0]), np.zeros(size[1])
    found = _linearized(problem, chosen, quantities, at, np.asarray(xi), x, r)
    A, B, C, D, f = (np.asarray(part) for part in found)
    rows = {
        name: (np.eye(size[0])[names.index(name)], np.zeros(size[1])) for name in own
    }
    rows |= {q.name: (C[k], D[k]) for k, q in enumerate(quantities)}
    ordered = [rows[_plain(name, rows)] for name in outputs]
    by_x = np.array([row for row, _ in ordered]).reshape(len(ordered), size[0])
    by_r = np.array([row for _, row in ordered]).reshape(len(ordered), size[1])
    return LinearModel(A, B, by_x, by_r, f, names, tuple(inputs), tuple(outputs))


def _plain(name: str, rows: Mapping[str, Any]) -> str:
    if name in rows:
        return name
    return name.removeprefix("start.").removeprefix("state.")


def _input(problem: AbstractProblem, name: str) -> tuple[str, paths.Keys]:
    """An input by its name: one that acts on the body, or the path of a number."""
    of_scene = isinstance(problem.model, Scene)
    acting = (*INPUTS, *_motors(problem.model)) if of_scene else ()
    if name in acting:
        return name, ()
    try:
        keys = paths.keys_of(name)
        value = paths.found(problem.model, keys)
    except (FieldError, LookupError):
        keys, value = (), ()
    if paths.is_floating(np.asarray(value)) and not np.shape(value):
        return name, keys
    known = [*acting, *paths.floats(problem.model)]
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    meant = f"did you mean {near[0]!r}? " if near else ""
    remedy = f"{meant}name one of: {', '.join(known)} (with an index)"
    raise FieldError("linearize.inputs", name, "is no input", remedy)


def _motors(scene: Scene) -> tuple[str, ...]:
    """Names of the forces on the coordinates of what is carried."""
    return tuple(f"force alpha[{k}]" for k in range(scene.coordinate_count))


class _Pushed(AbstractSupported):
    """Something carried, with constant forces on its coordinates beside its own."""

    count: int = eqx.field(static=True)
    own: AbstractSupported
    push: Float[Array, " n"]

    def carried(
        self, t: Array, alpha: Float[Array, " n"], alpha_dot: Float[Array, " n"]
    ) -> Carried:
        """Its masses at one instant."""
        return self.own.carried(t, alpha, alpha_dot)

    def generalized_force(
        self, t: Array, alpha: Float[Array, " n"], alpha_dot: Float[Array, " n"]
    ) -> Float[Array, " n"]:
        """Its own and the constant ones [J per unit of alpha]."""
        own = self.own.generalized_force(t, alpha, alpha_dot)
        return self.push if own is None else own + self.push

    def potential_energy(self, alpha: Float[Array, " n"]) -> Float[Array, ""] | None:
        """Energy of its springs [J]."""
        return self.own.potential_energy(alpha)

    @property
    def does_work(self) -> bool:
        """True: forces do."""
        return True


def _pushed(scene: Scene, push: Float[Array, " n"]) -> Scene:
    """A scene with forces on the coordinates of what is carried [J per their unit]."""
    parts: list[AbstractSupported] = []
    first = 0
    for part in scene.supported:
        last = first + part.count
        parts.append(
            _Pushed(part.count, part, push[first:last]) if part.count else part
        )
        first = last
    return eqx.tree_at(lambda s: s.supported, scene, tuple(parts))


def _driven(model: Any, inputs: _Inputs, r: Float[Array, " r"]) -> Any:
    """The scene or system with inputs r added."""
    loads: list[AbstractLoad] = []
    motors = _motors(model) if isinstance(model, Scene) else ()
    push = jnp.zeros(len(motors), r.dtype)
    for k, (name, keys) in enumerate(inputs):
        if keys:
            value = jnp.asarray(paths.found(model, keys)) + r[k]
            model = paths.replaced(model, keys, value)
            continue
        if name in motors:
            push = push.at[motors.index(name)].add(r[k])
            continue
        act, axis = name.rsplit(" ", 1)
        vector = jnp.eye(3, dtype=r.dtype)["xyz".index(axis)] * r[k]
        if act == "base acceleration":  # a field against it, in the base's own frame
            loads.append(Gravity(-vector))
        elif act == "force":
            loads.append(Force(vector, model.body.center_of_mass))
        else:
            loads.append(Torque(vector))
    if loads:
        whole = (*model.loads, *loads)
        model = eqx.tree_at(lambda s: s.loads, model, whole)
    if any(name in motors for name, _ in inputs):
        model = _pushed(model, push)
    return model


@for_one_call
def _linearized(
    problem: AbstractProblem,
    inputs: _Inputs,
    quantities: tuple[Quantity, ...],
    state: Any,
    xi: Float[Array, " K"],
    x: Float[Array, " n"],
    r: Float[Array, " r"],
) -> tuple[Array, Array, Array, Array, Array]:
    n, q = x.shape[0], len(quantities)

    def at(z: Array) -> tuple[Array, Array]:
        there = problem.with_model(_driven(problem.model, inputs, z[n:]))

        def image(x: Array) -> Array:
            return there.image(state, there.moved(state, x))

        y = there.moved(state, z[:n])
        rates, group = there.rates(y), there.generator(y, xi)
        place: Callable[[Any], Array] = lambda y: there.image(state, y)
        _, along = cast(tuple[Array, Any], jax.linearize(place, y))
        moving = cast(Array, along(rates)) - cast(Array, along(group))
        basis = cast(Array, jax.jacfwd(image)(z[:n]))
        velocity = least_squares(basis, moving)
        values = [value(there, y, xi) for value in quantities]
        told = jnp.stack(values) if values else velocity[:0]
        return jnp.concatenate([velocity, told]), velocity

    z = jnp.concatenate([x, r])
    slopes, f = cast(tuple[Array, Array], jax.jacfwd(at, has_aux=True)(z))
    A, B = slopes[:n, :n], slopes[:n, n:]
    return A, B, slopes[n : n + q, :n], slopes[n : n + q, n:], f
