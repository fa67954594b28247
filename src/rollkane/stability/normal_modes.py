"""Normal modes: periodic motions that begin as small vibrations about a rest."""

from collections.abc import Mapping
from os import PathLike
from typing import Any, ClassVar, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..kinematics.coordinates import State
from ..validation.checks import FieldError, real, whole
from .closing_newton import scales
from .independent_coordinates import IndependentCoordinates, independent_coordinates
from .neutral import neutral
from .periodic import PeriodicMotion, periodic_motion
from .periodic_family import periodic_family
from .shooting import measured
from .spectrum import Spectrum
from .steady import spectrum_at_rest
from .surface_motions import echelon
from .symmetries import symmetries

_FIELD = "normal_mode_motion"
AMPLITUDE = "amplitude"
# Of a rate: what differences of eigenvalues and vectors count as none. A double
# eigenvalue is known to the root of its rounding, 1e-13: to 3e-7.
_LOOSE = 1e-6
# [1/s]: what the fastest rate counts as where nothing moves by itself.
_STILL = 1e-6
# Rates of a rest over those that gravity would make in the time of a vibration.
_RESTS = 1e-8
# Where vibrations begin [rad] or [m].
_LINEAR = 0.01
_Complex: TypeAlias = np.ndarray[Any, np.dtype[np.complex128]]
_Pair: TypeAlias = tuple[_Complex, _Complex]


class NormalModes(NamedTuple):
    """Small vibrations about a rest.

    Attributes:
        frequencies: In rising order, each as often as it has modes [rad/s], shape (p,).
        shapes: Changes of the independent coordinates where the vibration turns, at
            rest, the largest of them one; shape (p, n). One that turns nowhere (a force
            across the velocity, a flywheel) has both parts, places and velocities, as
            it passes; the largest of its places is one.
        coordinates: Names of these.
        around: The coordinates.
    """

    frequencies: np.ndarray
    shapes: np.ndarray
    coordinates: tuple[str, ...]
    around: IndependentCoordinates

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw the shapes of the modes (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_spectra import plot_normal_modes

        return plot_normal_modes(self, path, title)


class Amplitude(eqx.Module):
    """How far a state is along a mode's shape [the unit of its largest coordinate].

    Changes along the symmetries at the rest do not count.
    """

    around: IndependentCoordinates
    row: Float[Array, " n"]

    # symmetries leave it as it is near the rest only
    is_local: ClassVar[bool] = True

    def __call__(self, scene: Scene, t: Array, state: State) -> Array:
        """Its value."""
        del scene, t
        return self.row @ self.around.coordinates(state)


def normal_modes(scene: Scene, rest: State) -> NormalModes:
    """Vibrations about a rest, those whose frequency [rad/s] is not zero.

    Each frequency comes as often as it has vibrations. Of equal ones (a bowl of
    revolution) the shapes are told apart by the independent coordinates, of which each
    has one that the others lack. What decays or grows, by more than 1e-6 of its
    frequency in a radian, repeats nothing and is not among them.

    Args:
        scene: What rolls on what; nothing in it depends on time.
        rest: Where it stays, such as ``rk.steady_motion(...).state``.

    Raises:
        FieldError: a state that does not stay; one whose vibrations all decay or grow.
    """
    around = independent_coordinates(scene, rest)
    rates, slopes = (np.asarray(x) for x in _linear(around))
    fastest = float(np.sqrt(np.abs(np.linalg.eigvals(slopes @ slopes)).max()))
    size = scales(around, 2.0 * np.pi / max(fastest, _STILL))
    largest = float(np.abs(rates / size).max())
    if not largest <= _RESTS * max(fastest, _STILL):
        problem = f"does not stay at rest: its rates are {largest:.2g} [1/s]"
        remedy = "find the rest with rollkane.steady_motion, and give its state"
        raise FieldError("normal_modes.rest", "...", problem, remedy)
    like = slopes * size[None] / size[:, None]
    told = spectrum_at_rest(scene, around.reference)
    _refuse_damped(told)
    frequencies, shapes = _vibrations(like, told, around, size)
    return NormalModes(frequencies, shapes, around.names, around)


@for_one_call
def _linear(around: IndependentCoordinates) -> tuple[Array, Array]:
    """Rates of the coordinates, and their derivative."""
    scene, t = around.scene, around.time

    def rates(x: Array) -> tuple[Array, Array]:
        moved = cast(State, rolling_derivative(scene, t, around.state(x)))
        found = around.velocity(x, moved)
        return found, found

    origin = jnp.zeros(around.count, t.dtype)
    slopes, value = cast(tuple[Array, Array], jax.jacfwd(rates, has_aux=True)(origin))
    return value, slopes


def _vibrations(
    like: np.ndarray,
    told: Spectrum,
    around: IndependentCoordinates,
    size: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and shapes of a linear model in coordinates of like size."""
    values, vectors = cast(_Pair, np.linalg.eig(like))
    places = _swings(values, told)
    fixed = {"turn", "contact on base", "contact on body", "alpha"}
    parts = [np.full(k, name in fixed) for name, k in around.sizes.items()]
    still = np.concatenate(parts)
    frequencies: list[float] = []
    shapes: list[np.ndarray] = []
    while places.size:
        first = values.imag[places[0]]
        same = places[values.imag[places] - first < _LOOSE * first]
        for row in _shapes(vectors[:, same], still):
            shape = row * size
            largest = np.argmax(np.abs(np.where(still, shape, 0.0)))
            frequencies.append(float(first))
            shapes.append(shape / shape[largest])
        places = places[same.size :]
    whole_shape = np.stack(shapes) if shapes else np.zeros((0, size.size))
    return np.array(frequencies), whole_shape


def _swings(values: np.ndarray, told: Spectrum) -> np.ndarray:
    """Which eigenvalues are vibrations, slowest first.

    Those nearest to what symmetries and steady drifts leave, whose zeros come in chains
    that are known to the cube root of the rounding only: 5e-5 of the fastest rate,
    where a slow vibration may be.
    """
    own, near = cast(_Complex, told.eigenvalues), _near(told)
    own = own[(own.imag > near) & (np.abs(own.real) < near)]
    left, places = list(range(values.size)), list[int]()
    for value in own[np.argsort(own.imag, kind="stable")]:
        best = min(left, key=lambda k: abs(values[k] - value))
        left.remove(best)
        places.append(best)
    return np.array(places, int)


def _near(told: Spectrum) -> np.ndarray:
    """What parts of eigenvalues count as none [1/s]."""
    return np.maximum(told.errors, _LOOSE * np.abs(told.eigenvalues))


def _refuse_damped(told: Spectrum) -> None:
    """Refuse a rest about which all that vibrates decays or grows."""
    own, near = cast(_Complex, told.eigenvalues), _near(told)
    own, near = own[own.imag > near], near[own.imag > near]
    if not own.size or np.any(np.abs(own.real) < near):
        return
    slowest = own[np.argmin(own.imag)]
    does = "decay" if np.all(own.real < 0.0) else "decay or grow"
    problem = (
        f"has no vibration that repeats: all {does}, the slowest by "
        f"{slowest.real:.3g} 1/s at {slowest.imag:.6g} rad/s"
    )
    remedy = "leave out what damps or drives, or take steady_motion(...).eigenvalues"
    raise FieldError("normal_modes.rest", "...", problem, remedy)


def _shapes(vectors: _Complex, still: np.ndarray) -> np.ndarray:
    """Real shapes of vibrations of one frequency, at rest where they turn.

    Args:
        vectors: Its eigenvectors, shape (n, m).
        still: Which coordinates are no velocities.

    Returns:
        One for each vibration, shape (m, n).
    """
    count = vectors.shape[1]
    rows = np.concatenate([vectors.real, vectors.imag], axis=1).T
    basis = np.linalg.svd(rows)[2][: rows.shape[0]]
    left, values, _ = np.linalg.svd(basis[:, ~still])
    full = np.zeros(basis.shape[0])
    full[: values.size] = values
    resting = left.T[full < _LOOSE] @ basis
    found: list[np.ndarray] = []
    seen = np.zeros((0, count), complex)
    # a real vector is the real part of the eigenvectors times complex weights. What is
    # passed a quarter of a period later has i times the same: no other vibration
    parts = np.concatenate([vectors.real, -vectors.imag], axis=1)
    weighed = cast(np.ndarray, np.linalg.pinv(parts))
    for row in (*echelon(resting), *echelon(basis)):
        both = weighed @ row
        weights: _Complex = both[:count] + 1j * both[count:]
        unit = weights / np.sqrt(both @ both)
        tried = np.concatenate([seen, unit[None]])
        if np.linalg.svd(tried, compute_uv=False)[-1] > _LOOSE:
            found, seen = [*found, row], tried
        if len(found) == count:
            break
    return np.stack(found)


def normal_mode_motion(
    scene: Scene,
    rest: State,
    amplitude: Any,
    *,
    mode: int = 0,
    hold: Mapping[str, Any] | None = None,
    segments: int = 1,
    rtol: float | None = None,
    method: str = "auto",
) -> PeriodicMotion:
    """The periodic motion that a normal mode becomes at a finite amplitude.

    Args:
        scene: What rolls on what; nothing in it depends on time.
        rest: Where it stays at rest, such as ``rk.steady_motion(...).state``.
        amplitude: How far from the rest along the mode's shape the motion begins, in
            its largest place [rad], [m] or that of alpha.
        mode: Its number, in rising frequency; see
            :func:`rollkane.stability.normal_modes.normal_modes`.
        hold: What else is to have a value, as of :func:`rollkane.periodic_motion`.
        segments: Runs that a period is made of.
        rtol: Relative tolerance of a step [1]; 1e-12 by default.
        method: ``"auto"``, ``"native"`` or ``"diffrax"``.

    Raises:
        FieldError: a state that does not stay at rest, a mode that there is not or
            that decays, an amplitude to which the family does not go.
    """
    modes = normal_modes(scene, rest)
    count = modes.frequencies.size
    mode = whole(f"{_FIELD}.mode", mode, 0, f"give 0 to {count - 1}")
    if mode >= count:
        problem = f"is not one of the {count} normal modes of this rest"
        remedy = f"give 0 to {count - 1}" if count else "give a rest that vibrates"
        raise FieldError(f"{_FIELD}.mode", mode, problem, remedy)
    far = float(real(f"{_FIELD}.amplitude", amplitude, (), "a number that is not 0"))
    if far == 0.0:
        remedy = "give a number that is not 0"
        raise FieldError(f"{_FIELD}.amplitude", 0.0, "is that of the rest", remedy)
    shape = modes.shapes[mode]
    period = float(2.0 * np.pi / modes.frequencies[mode])
    along = Amplitude(modes.around, jnp.asarray(_row(modes, shape, period)))
    options: dict[str, Any] = {"segments": segments, "rtol": rtol, "method": method}
    # from where the vibration is nearly linear the family leads to the amplitude: a
    # guess far off may be near another motion
    near = far if abs(far) <= _LINEAR else float(np.copysign(_LINEAR, far))
    guess = _moved(modes.around, jnp.asarray(near * shape))
    asked = {**(hold or {}), AMPLITUDE: (along, None)}
    found = periodic_motion(scene, guess, period, hold=asked, **options)
    if near == far:
        return found
    end = _moved(modes.around, jnp.asarray(far * shape))
    aim = float(measured(along, scene, modes.around.time, end)[0])
    span = sorted((found.measure(AMPLITUDE), aim))
    family = periodic_family(
        scene, found, AMPLITUDE, (span[0], span[1]), hold=hold, points=10
    )
    place = 0 if aim < 0.0 else -1
    if family.ends[place] != "span":
        reached = family.points[place].measure(AMPLITUDE)
        problem = (
            f"is not reached: at {reached:.6g} the family ends ({family.ends[place]})"
        )
        remedy = "give a smaller one, or follow the family with periodic_family"
        raise FieldError(f"{_FIELD}.amplitude", far, problem, remedy)
    return family.points[place]


def _row(modes: NormalModes, shape: np.ndarray, period: float) -> np.ndarray:
    """One for the shape, zero along the symmetries at the rest, shape (n,)."""
    around = modes.around
    size = scales(around, period)
    known = neutral(around, symmetries(around.scene)).directions / size
    own = shape / size
    for direction in _orthonormal(known):
        own = own - direction * (direction @ own)
    return own / size / (own @ own)


def _orthonormal(rows: np.ndarray) -> np.ndarray:
    return np.linalg.qr(rows.T)[0].T


@for_one_call
def _moved(around: IndependentCoordinates, x: Float[Array, " n"]) -> State:
    return around.state(x)
