"""Random scenes from nanometres to gigametres: whether a completed run kept its energy.

A scene is drawn by its size: a body between 1e-9 and 1e9 m across, of 1e-12 to 1e12 kg,
on a base that is 3 to 1000 times as large, for three of its own times
``sqrt(size / g)``, at angular velocities of one radian in such a time. What has no unit
(shapes, ratios, directions) is drawn alike at every size, so that a number with a unit
in the library, such as a tolerance in metres, shows as runs that fail or are refused at
one end of the range.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.dynamics.observables import kinetic_energy
from rollkane.geometry.rotations import rotation_matrix
from rollkane.geometry.surfaces import AbstractSurface

from .fuzzing import Draw

NUMBERS = 64  # drawn for a scene
GRAVITY = 9.81  # [m/s^2]
OUTPUTS = 9
MAX_STEPS = 20_000  # sixty times what the longest of 250 discs takes
RTOL = 1e-9  # the default of `rk.simulate` in double precision
EPS = float(np.finfo(float).eps)
# Energy errors over tolerance and rounding. The error of a step is rtol in the mean
# square of up to 16 numbers, of which one may have it all: 4 times. The energy of the
# motion is quadratic in the angular velocity: 2 times. A run takes 20 to 120 steps, and
# up to 300 where a disc is nearly flat; their errors may add up: 100 times, 800 in all.
LIMIT = 1e3


class Shapes(NamedTuple):
    """Two surfaces, and where they touch.

    Attributes:
        body: Its surface.
        base: Its surface.
        point: Of the base [m], base axes, shape (3,).
    """

    body: AbstractSurface
    base: AbstractSurface
    point: jax.Array


class Kind(NamedTuple):
    """What the scenes of a kind have in common.

    Attributes:
        shapes: Of the numbers of a scene, the body's size and the base's [m].
        law: Of the contact.
        turns: Whether the base turns steadily.
        carries: Whether there is a pendulum in the body.
        down: Direction of gravity, fixed axes.
    """

    shapes: Callable[[Draw, jax.Array, jax.Array], Shapes]
    law: type[rk.Rolling] = rk.Rolling
    turns: bool = False
    carries: bool = False
    down: tuple[float, float, float] = (0.0, 0.0, -1.0)


def direction(d: Draw) -> jax.Array:
    """A unit vector, spread evenly."""
    z, angle = d(-1.0, 1.0), d(-np.pi, np.pi)
    across = jnp.sqrt(1.0 - z * z)
    return jnp.stack([across * jnp.cos(angle), across * jnp.sin(angle), z])


def quaternion(d: Draw) -> jax.Array:
    """Of a rotation by up to half a turn about any axis."""
    half = d(0.0, 0.5 * np.pi)
    return jnp.concatenate([jnp.cos(half)[None], jnp.sin(half) * direction(d)])


def egg(s, p):
    """Meridian of an egg; smooth at both poles."""
    return p[0] * jnp.sin(s) * (1.0 + p[2] * jnp.cos(s)), -p[1] * jnp.cos(s)


def pear(n, p):
    """An ellipsoid that is thicker at one end, by the direction from its middle."""
    return p[:3] * n * (1.0 + p[3] * n[2])


def cushion(x, p):
    """A level function between those of an ellipsoid and of a box."""
    u = x / p[:3]
    square = u * u
    return jnp.sum(square + p[3] * square * square) - 1.0


def hills(x, y, p):
    """Heights of a ground with waves of a length of its own."""
    waves = jnp.sin(x / p[0] + p[2]) + 0.5 * jnp.cos(y / p[0])
    return p[0] * p[1] * waves


def sphere_on_plane(d, size, large):
    return Shapes(rk.Sphere(size), rk.Plane(), _on_floor(d, large))


def _on_floor(d, reach):
    return jnp.concatenate([d(-1.0, 1.0, (2,)) * reach, jnp.zeros(1)])


def ellipsoid_on_sphere(d, size, large):
    body = rk.Ellipsoid(size * d(0.3, 1.0, (3,)))
    return Shapes(body, rk.Sphere(large), large * direction(d))


def sphere_in_sphere(d, size, large):
    return Shapes(rk.Sphere(size), rk.Sphere(large, inside=True), large * direction(d))


def ellipsoid_in_ellipsoid(d, size, large):
    # 3 * 0.75^2 > 1 / 0.7: the body is everywhere the more curved of the two
    axes = large * d(0.75, 1.0, (3,))
    bowl = rk.Ellipsoid(axes, inside=True)
    body = rk.Ellipsoid(size * d(0.7, 1.0, (3,)))
    return Shapes(body, bowl, axes * direction(d))


def torus_on_plane(d, size, large):
    tube = size * d(0.1, 0.45)
    return Shapes(rk.Torus(size - tube, tube), rk.Plane(), _on_floor(d, large))


def disc_on_plane(d, size, large):
    return Shapes(rk.DiscEdge(size), rk.Plane(), _on_floor(d, large))


def ring_in_sphere(d, size, large):
    bowl = rk.Sphere(large, inside=True)
    return Shapes(rk.Ring(size), bowl, large * direction(d))


def egg_on_graph(d, size, large):
    numbers = size * d(0.6, 0.9), size * d(0.6, 0.9), d(0.0, 0.2)
    body = rk.Revolution(egg, jnp.stack(numbers), poles=(True, True), rising=True)
    waves = jnp.stack([large, d(0.0, 0.2), d(0.0, 6.0)])
    x, y = d(-1.0, 1.0, (2,)) * large
    point = jnp.stack([x, y, hills(x, y, waves)])
    return Shapes(body, rk.Graph(hills, waves), point)


def pear_on_cylinder(d, size, large):
    numbers = jnp.concatenate([size * d(0.6, 0.9, (3,)), d(0.0, 0.1, (1,))])
    body = rk.Parametric(pear, numbers, of_direction=True)
    angle, along = d(-np.pi, np.pi), d(-1.0, 1.0) * large
    round_ = large * jnp.cos(angle), large * jnp.sin(angle)
    return Shapes(body, rk.Cylinder(large), jnp.stack([*round_, along]))


def cushion_in_sphere(d, size, large):
    numbers = jnp.concatenate([size * d(0.8, 1.0, (3,)), d(0.0, 0.3, (1,))])
    body = rk.Implicit(cushion, numbers, size=1.5 * size)
    bowl = rk.Sphere(large, inside=True)
    return Shapes(body, bowl, large * direction(d))


def sphere_in_cone(d, size, large):
    slope, angle = d.size(0.1, 2.0), d(-np.pi, np.pi)
    # the ball fits at a distance of slope * size from the axis
    way = (1.0 + slope) * large
    point = way * jnp.stack([jnp.cos(angle), jnp.sin(angle), slope])
    return Shapes(rk.Sphere(size), rk.Cone(slope, inside=True), point)


def ellipsoid_on_torus(d, size, large):
    body = rk.Ellipsoid(size * d(0.5, 1.0, (3,)))
    tube = 0.4 * large
    round_, angle = d(-np.pi, np.pi), d(-np.pi, np.pi)
    way = large + tube * jnp.cos(angle)
    point = [way * jnp.cos(round_), way * jnp.sin(round_), tube * jnp.sin(angle)]
    return Shapes(body, rk.Torus(large, tube), jnp.stack(point))


KINDS = {
    "sphere with a pendulum on a plane": Kind(sphere_on_plane, carries=True),
    "sphere in a spinning sphere": Kind(sphere_in_sphere, turns=True),
    "ellipsoid on a sphere": Kind(ellipsoid_on_sphere),
    "ellipsoid in an ellipsoid": Kind(ellipsoid_in_ellipsoid),
    "torus on a turntable": Kind(torus_on_plane, turns=True),
    "disc on a plane, rubber": Kind(disc_on_plane, rk.RubberRolling),
    "ring in a sphere": Kind(ring_in_sphere),
    "egg on hills": Kind(egg_on_graph),
    "pear on a lying cylinder": Kind(pear_on_cylinder, down=(0.0, -1.0, 0.0)),
    "cushion in a sphere": Kind(cushion_in_sphere),
    "sphere in a spinning cone": Kind(sphere_in_cone, turns=True),
    "ellipsoid on a torus, rubber": Kind(ellipsoid_on_torus, rk.RubberRolling),
}


class Energies(NamedTuple):
    """What is judged of a batch, a row for each scene.

    Attributes:
        size: Of the body [m].
        mass: [kg].
        code: Why the run ended.
        kept: What is constant, the energy or the moving energy [J], shape (n, outputs).
        kinetic: Energy of the motion [J].
        given: What the turning base has given, ``w_c . J`` [J].
        reach: Distance of the body from the fixed origin [m].
    """

    size: np.ndarray
    mass: np.ndarray
    code: np.ndarray
    kept: np.ndarray
    kinetic: np.ndarray
    given: np.ndarray
    reach: np.ndarray


def drawn_numbers(name: str, count: int, seed: int = 0) -> np.ndarray:
    """For many scenes of a kind."""
    draw = np.random.default_rng([seed, list(KINDS).index(name)])
    return draw.random((count, NUMBERS))


def body_of(d: Draw, mass, size, surface) -> rk.Body:
    """A body with the moments of a box that is turned and off the middle."""
    square = (size * d(0.2, 1.0, (3,))) ** 2
    turn = rotation_matrix(quaternion(d))
    moments = mass * d(0.1, 0.4) * (jnp.sum(square) - square)
    inertia = turn @ jnp.diag(moments) @ turn.T
    # no part is longer than 0.2 size / sqrt(3)
    return rk.Body(mass, inertia, surface, size * d(-0.115, 0.115, (3,)))


def pendulum_of(d: Draw, mass, size) -> rk.PointMasses:
    """A mass on a rod in the body, with a spring."""
    stiffness = mass * GRAVITY * size * d(0.0, 1.0)
    return rk.PointMasses(
        mass * d.size(1e-2, 10.0, (1,)),
        lambda a, p: p[0] * jnp.stack([jnp.sin(a), 0.0 * a, -jnp.cos(a)], axis=1),
        potential=lambda a, p: 0.5 * p[1] * a[0] ** 2,
        parameters=jnp.stack([0.5 * size, stiffness]),
    )


def run(name: str, numbers: np.ndarray, method: str = "native") -> Energies:
    """All scenes of a kind, in one batch."""
    kind = KINDS[name]

    def one(numbers):
        d = Draw(numbers)
        size, mass = d.size(1e-9, 1e9), d.size(1e-12, 1e12)
        large = size * d.size(3.0, 1e3)
        beat = jnp.sqrt(size / GRAVITY)
        body, base, point = kind.shapes(d, size, large)
        # a turn of one radian in the time of the base's own size
        turning = rk.Spin(d(-1.0, 1.0) * jnp.sqrt(GRAVITY / large))
        carried = (pendulum_of(d, mass, size),) if kind.carries else ()
        scene = rk.Scene(
            body_of(d, mass, size, body),
            rk.Base(base, turning if kind.turns else None),
            supported=carried,
            loads=(rk.Gravity(GRAVITY * np.array(kind.down)),),
            contact=kind.law(),
        )
        rest = [d(-1.0, 1.0, (1,)), d(-1.0, 1.0, (1,)) / beat] if kind.carries else []
        turn, spin = quaternion(d), d(-1.0, 1.0, (3,)) / beat
        start = rk.place(scene, turn, spin, point, *rest)
        times = jnp.linspace(0.0, 3.0, OUTPUTS) * beat
        found = rk.simulate(scene, start, times, method=method, max_steps=MAX_STEPS)
        kinetic = lambda t, state: kinetic_energy(scene, t, state)
        total = mass + sum(jnp.sum(x.mass) for x in carried)
        return Energies(
            size=size,
            mass=total,
            code=found.code,
            kept=found.moving_energy,
            kinetic=jax.vmap(kinetic)(found.time, found.state),
            given=found.energy - found.moving_energy,
            reach=jnp.linalg.norm(found.position, axis=1),
        )

    return Energies(*map(np.asarray, jax.jit(jax.vmap(one))(jnp.asarray(numbers))))


def excess(found: Energies) -> np.ndarray:
    """Largest energy error of each run, over its tolerance and rounding [1].

    The tolerance is of the energies that change into each other: of the motion, what
    the base gives, and the potential one, of which only the change counts. Rounding is
    that of the potential energy from the fixed origin, which is far away on a large
    base: the place of a body there is known to eps of its distance.
    """
    potential = found.kept + found.given - found.kinetic
    changed = np.ptp(potential, axis=1)
    moved = np.max(np.abs(found.kinetic), axis=1) + np.max(np.abs(found.given), axis=1)
    weight = found.mass * GRAVITY * np.max(found.reach, axis=1)
    error = np.max(np.abs(found.kept - found.kept[:, :1]), axis=1)
    return error / (RTOL * (moved + changed) + EPS * weight)


def failures(found: Energies) -> list[tuple[int, str]]:
    """Scenes whose run completed and did not keep its energy, and by how much."""
    wrong = []
    over = excess(found)
    for i in np.flatnonzero(found.code == rk.Code.COMPLETED):
        if not np.isfinite(over[i]):
            wrong.append((int(i), "completed, with NaN"))
        elif over[i] > LIMIT:
            wrong.append((int(i), f"energy error {over[i]:.2g} times the tolerance"))
    return wrong
