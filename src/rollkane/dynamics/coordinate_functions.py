"""A user's functions of coordinates alpha: wrapped, counted, and differentiated."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.dependence import reached_numbers
from ..codegen.scalar_program import NotElementwiseError
from ..geometry.small_linear import components
from ..validation.checks import FieldError, is_traced, known_in_a_trace
from ..validation.user_functions import UserFunction, accepts, as_floats, check_output

# So many are solved for in one system as fast, and compiled as soon, as one by one.
FEW = 3
# Coordinates of one part are counted up to here when the user does not say how many.
_MOST_COORDINATES = 8

_Given: TypeAlias = dict[str, Callable[..., Any] | None]
_OfAlpha: TypeAlias = Callable[[Array], Array]
_Shapes: TypeAlias = dict[str, tuple[int, ...]]


class Made(eqx.Module):
    """Functions of one carried part, ready for use.

    Attributes:
        functions: Name to wrapped function, None for one that was not given.
        parameters: That all of them take last, or None.
        count: Number of coordinates n.
    """

    functions: dict[str, Any]
    parameters: Any
    count: int = eqx.field(static=True)


def functions_of(
    owner: str, given: _Given, shapes: _Shapes, parameters: Any, count: object
) -> Made:
    """The functions of a part, wrapped, with the number of coordinates that fits.

    Args:
        owner: Name used in errors, such as ``PointMasses``.
        given: Name to function: ``position``, ``force``, ``potential``, and for a body
            ``rotation``; None for one that is not given.
        shapes: Shapes of ``position`` and ``rotation``.
        parameters: Tree of numbers that all of them may take last.
        count: Number of coordinates, or None: the number that fits all functions, and
            if several do, as many as the places depend on.

    Raises:
        FieldError: a function that fits no number, or a number that cannot be found.
    """
    if count is not None:
        if isinstance(count, bool) or not isinstance(count, int) or count < 0:
            field = f"{owner}.coordinates"
            raise FieldError(
                field, count, "must be a whole number", "give 0, 1, 2, ..."
            )
        return _wrapped(owner, given, shapes, parameters, count)
    fitting: list[Made] = []
    refusal: FieldError | None = None
    for n in range(_MOST_COORDINATES + 1):
        try:
            fitting.append(_wrapped(owner, given, shapes, parameters, n))
        except FieldError as error:
            refusal = refusal or error if n == 0 else error if n == 1 else refusal
    if not fitting:
        assert refusal is not None
        raise refusal
    if len(fitting) == 1:
        return fitting[0]
    # indexing alpha[1] of too short an array is no error in JAX: see what is used
    used = _used_coordinates(owner, fitting[-1])
    return next((made for made in fitting if made.count >= used), fitting[-1])


def _wrapped(
    owner: str, given: _Given, shapes: _Shapes, parameters: Any, n: int
) -> Made:
    shapes = shapes | {"force": (n,), "potential": ()}
    functions: dict[str, Any] = {}
    parameters = as_floats(parameters)
    for name, function in given.items():
        field = f"{owner}.{name}"
        if function is None:
            functions[name] = None
            continue
        size = 1 + 2 * n if name == "force" else n
        takes = parameters is not None and accepts(function, 4)
        if name == "force" and callable(function):
            function = _Force(function, n, takes)
        wrapped = UserFunction(field, function, size, parameters, True, shared=True)
        check_output(field, wrapped.of(parameters), (size,), shapes[name])
        functions[name] = wrapped
    return Made(functions, parameters, n)


class _Force(eqx.Module):
    """``force(t, alpha, alpha_dot)`` as a function of one array (t, alpha, alpha')."""

    force: Any
    n: int = eqx.field(static=True)
    takes_parameters: bool = eqx.field(static=True)

    def __call__(self, arguments: Float[Array, " m"], parameters: Any = None) -> Array:
        """Generalized forces."""
        alpha, alpha_dot = arguments[1 : 1 + self.n], arguments[1 + self.n :]
        extra = (parameters,) if self.takes_parameters else ()
        result = self.force(arguments[0], alpha, alpha_dot, *extra)
        if isinstance(result, (tuple, list)):
            parts = cast(Sequence[Any], result)
            result = jnp.stack([jnp.asarray(x) for x in parts])
        return result


def _used_coordinates(owner: str, made: Made) -> int:
    """Number of coordinates that the places of a part depend on."""
    used = 0
    # two odd places: a derivative that vanishes at one of them by chance
    for seed in (0.37, -1.13):
        alpha = seed + 0.21 * np.arange(made.count, dtype=jnp.result_type(float))
        for name in ("position", "rotation"):
            function = made.functions.get(name)
            if function is None:
                continue
            of_alpha = function.of(made.parameters)
            derivative = cast(Callable[..., Array], jax.jacfwd(of_alpha))
            slopes = known_in_a_trace(derivative, alpha)
            if is_traced(slopes):
                raise FieldError(
                    f"{owner}.coordinates",
                    None,
                    "cannot be found while the functions depend on traced numbers",
                    "say how many coordinates there are: coordinates=1",
                )
            moved = np.abs(np.asarray(slopes)).reshape(-1, made.count).max(axis=0) > 0
            used = max(used, int(np.max(np.flatnonzero(moved), initial=-1)) + 1)
    return used


def moved(
    function: _OfAlpha, alpha: Float[Array, " n"], alpha_dot: Float[Array, " n"]
) -> tuple[Array, Array, Array, tuple[Array, ...]]:
    """Value, rate, second rate at alpha'' = 0, and partial derivatives."""
    if not alpha.shape[0]:
        value = function(alpha)
        return value, jnp.zeros_like(value), jnp.zeros_like(value), ()
    rates = rates_of(function, alpha, alpha_dot)
    partials = tuple(
        jax.jvp(function, (alpha,), (unit,))[1]
        for unit in jnp.eye(alpha.shape[0], dtype=alpha.dtype)
    )
    return *rates, partials


def rates_of(
    function: _OfAlpha, alpha: Float[Array, " n"], alpha_dot: Float[Array, " n"]
) -> tuple[Array, Array, Array]:
    """Value, rate, and second rate at alpha'' = 0."""

    def rate(alpha: Float[Array, " n"]) -> tuple[Array, Array]:
        return jax.jvp(function, (alpha,), (alpha_dot,))

    (value, velocity), (_, bias) = jax.jvp(rate, (alpha,), (alpha_dot,))
    return value, velocity, bias


class Apart(NamedTuple):
    """Coordinates each of which moves one mass alone.

    Attributes:
        each: How many every mass has.
        masses: How many masses there are.
        by_mass: Whether those of one mass follow each other in alpha; else the first
            ones of all masses come first.
    """

    each: int
    masses: int
    by_mass: bool

    def split(self, x: Float[Array, " n"]) -> list[Float[Array, " k"]]:
        """A number of each coordinate: first ones of all masses, second ones, ..."""
        if self.by_mass:
            return components(x.reshape(self.masses, self.each).T)
        return components(x.reshape(self.each, self.masses))

    def joined(self, parts: list[Float[Array, " k"]]) -> Float[Array, " n"]:
        """The numbers in the order of alpha again."""
        x = jnp.stack(parts)
        return (x.T if self.by_mass else x).reshape(-1)

    def partials(
        self, position: _OfAlpha, alpha: Float[Array, " n"]
    ) -> tuple[Float[Array, "3 k"], ...]:
        """What the first, the second, ... coordinate of every mass does to it."""
        every = jnp.eye(self.each, dtype=alpha.dtype)
        ones = jnp.ones((self.each, self.each, self.masses), alpha.dtype)
        seeds = every[:, :, None] * ones
        return tuple(
            jax.jvp(position, (alpha,), (self.joined(components(seed)),))[1].T
            for seed in components(seeds)
        )


def apart_of(
    position: UserFunction, parameters: Any, masses: int, coordinates: int
) -> Apart | None:
    """How coordinates are shared out among masses, by the program of their places.

    None where one coordinate may move several masses, or masses have different numbers
    of them.
    """
    if not masses or coordinates % masses:
        return None
    place: Callable[[Array, Any], Array] = lambda alpha, own: own[0](alpha, own[1])
    try:
        given = position, parameters
        moves = reached_numbers(place, coordinates, given).any(axis=1)
    except NotElementwiseError:
        return None
    each, index = coordinates // masses, np.arange(coordinates)
    for by_mass in (True, False):
        mass = index // each if by_mass else index % masses
        if not np.any(moves & (mass[None] != np.arange(masses)[:, None])):
            return Apart(each, masses, by_mass)
    return None
