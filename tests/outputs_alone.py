"""Whether a motion obeys mechanics, from its outputs alone.

Newton's and Euler's equations, the constraint of the contact, the law of its friction,
the balance of power and the shapes that touch are checked with NumPy: derivatives by
nine-point stencils, surfaces written down once more as level functions. Nothing of
rollkane is used but what a run gives out.
"""

import contextlib
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import rollkane as rk

DURATION = 0.6  # s, of a motion
COUNT = 150  # points in a row
# s, between the points of a stencil: nine points have an error of (w h)^8 w^k / 3150
# for a k-th derivative of what moves at the frequency w. Most motions here have w < 10
# rad/s; where one has a blow of milliseconds (a disc that nearly lies), its part of the
# motion is looked at once more with half the step.
LONGEST, SHORTEST = 4e-3, 6e-5
# Outputs are smooth within a step of the integrator. At its end a thousandth of its
# error (1e-14) costs 1e-14 / h^2 in a second derivative: 4e-8 at 5e-4 s, and no more of
# the forces of a blow, to which it is related, at shorter ones.
RESIDUAL = 1e-7
# Where the shortest does not resolve a blow either, which the difference from a stencil
# of seven points tells without any mechanics, it is left out.
FIRST_OF_7 = np.array([0, -1, 9, -45, 0, 45, -9, 1, 0]) / 60
SECOND_OF_7 = np.array([0, 2, -27, 270, -490, 270, -27, 2, 0]) / 180
FIRST = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840
SECOND = np.array([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9]) / 5040


class Shape(NamedTuple):
    """A surface once more, in NumPy.

    Attributes:
        level: Of points (n, 3): zero on the surface, positive out of the material.
        points: Points over the whole of it (n, 3), or none where it has no end.
        edge: Whether normals are not those of the level: a rim, a wire.
    """

    level: Callable[[np.ndarray], np.ndarray]
    points: np.ndarray | None = None
    edge: bool = False

    def normal(self, p: np.ndarray) -> np.ndarray:
        """Unit normal of the level, by central differences of the fourth order."""
        h = 1e-3
        slopes = []
        for axis in np.eye(3) * h:
            near = self.level(p + axis) - self.level(p - axis)
            far = self.level(p + 2 * axis) - self.level(p - 2 * axis)
            slopes.append((8 * near - far) / (12 * h))
        slope = np.stack(slopes, axis=-1)
        return slope / np.linalg.norm(slope, axis=-1, keepdims=True)


def directions(n: int = 3000) -> np.ndarray:
    k = np.arange(n) + 0.5
    z, angle = 1 - 2 * k / n, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def angles(n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    one = np.linspace(-np.pi, np.pi, n, endpoint=False)
    a, b = np.meshgrid(one, one)
    return a.ravel(), b.ravel()


def ring(p, a):
    """Distance from the wire of radius a in the plane z = 0."""
    return np.hypot(np.hypot(p[..., 0], p[..., 1]) - a, p[..., 2])


def _torus_points(R, r):
    a, b = angles()
    q = R + r * np.cos(b)
    return np.stack([q * np.cos(a), q * np.sin(a), r * np.sin(b)], axis=1)


def _disc_points(a):
    """Of the rim, and of the face within it."""
    angle, share = angles()
    q = a * np.sqrt(0.5 + share / (2 * np.pi))
    face = np.stack([q * np.cos(angle), q * np.sin(angle), 0.0 * q], axis=1)
    return np.concatenate([_torus_points(a, 0.0), face])


def _egg(theta):
    """Meridian of an egg: radius and height."""
    return 0.3 * np.sin(theta), -(0.4 + 0.05 * np.cos(theta)) * np.cos(theta)


def _egg_level(p):
    """Signed distance in the meridian's plane, from 4000 of its points and a parabola.

    Near the surface it is right to 1e-12: the nearest of the points is next to the foot
    of the perpendicular, which two steps of Newton's find.
    """
    shape = p.shape[:-1]
    rz = np.stack([np.hypot(p[..., 0], p[..., 1]), p[..., 2]], axis=-1).reshape(-1, 2)
    grid = np.linspace(0, np.pi, 400)
    places = np.stack(_egg(grid), axis=-1)
    s = grid[np.argmin(((rz[:, None] - places[None]) ** 2).sum(-1), axis=1)]
    for _ in range(8):
        r, z = _egg(s)
        r1, z1 = 0.3 * np.cos(s), 0.4 * np.sin(s) + 0.05 * np.sin(2 * s)
        r2, z2 = -0.3 * np.sin(s), 0.4 * np.cos(s) + 0.1 * np.cos(2 * s)
        dr, dz = r - rz[:, 0], z - rz[:, 1]
        bend = r1 * r1 + z1 * z1 + dr * r2 + dz * z2
        bend = np.where(bend > 0.1 * (r1 * r1 + z1 * z1), bend, r1 * r1 + z1 * z1)
        s = s - np.clip((dr * r1 + dz * z1) / bend, -0.02, 0.02)
    r, z = _egg(s)
    r1, z1 = 0.3 * np.cos(s), 0.4 * np.sin(s) + 0.05 * np.sin(2 * s)
    out = (rz[:, 0] - r) * z1 - (rz[:, 1] - z) * r1
    return np.copysign(np.hypot(rz[:, 0] - r, rz[:, 1] - z), out).reshape(shape)


def _hills(x, y):
    return 0.15 * np.sin(1.3 * x) * np.cos(1.1 * y) + 0.04 * x


A, B, C = 0.45, 0.35, 0.28
DOWN = np.array([0.0, 0.0, -2.0])


def _ellipsoid(p, a, b, c):
    return np.linalg.norm(p / np.array([a, b, c]), axis=-1) - 1.0


BODIES: dict[str, tuple[Callable, Shape]] = {
    "ball": (
        lambda: rk.Sphere(0.3),
        Shape(lambda p: np.linalg.norm(p, axis=-1) - 0.3, 0.3 * directions()),
    ),
    "ellipsoid": (
        lambda: rk.Ellipsoid((A, B, C)),
        Shape(lambda p: _ellipsoid(p, A, B, C), directions() * (A, B, C)),
    ),
    "torus": (
        lambda: rk.Torus(0.4, 0.12),
        Shape(lambda p: ring(p, 0.4) - 0.12, _torus_points(0.4, 0.12)),
    ),
    "disc": (
        lambda: rk.DiscEdge(0.4),
        Shape(lambda p: ring(p, 0.4), _disc_points(0.4), edge=True),
    ),
    "ring": (
        lambda: rk.Ring(0.4),
        Shape(lambda p: ring(p, 0.4), _torus_points(0.4, 0.0), edge=True),
    ),
    "egg": (
        lambda: rk.Revolution(
            lambda s: (0.3 * jnp.sin(s), -(0.4 + 0.05 * jnp.cos(s)) * jnp.cos(s))
        ),
        Shape(
            _egg_level,
            np.stack(
                [
                    _egg(np.abs(angles()[1]))[0] * np.cos(angles()[0]),
                    _egg(np.abs(angles()[1]))[0] * np.sin(angles()[0]),
                    _egg(np.abs(angles()[1]))[1],
                ],
                axis=1,
            ),
        ),
    ),
    "direction": (
        lambda: rk.Parametric(
            lambda d: d * jnp.asarray([A, B, C], d.dtype), of_direction=True
        ),
        Shape(lambda p: _ellipsoid(p, A, B, C), directions() * (A, B, C)),
    ),
    "implicit": (
        lambda: rk.Implicit(
            lambda x, y, z: (x / A) ** 2 + (y / B) ** 2 + (z / C) ** 2 - 1.0
        ),
        Shape(lambda p: _ellipsoid(p, A, B, C), directions() * (A, B, C)),
    ),
}
BASES: dict[str, tuple[Callable, Shape, Any]] = {  # and a point of it
    "plane": (rk.Plane, Shape(lambda p: p[..., 2]), lambda x, y: (x, y, 0.0)),
    "ball": (
        lambda: rk.Sphere(2.0, (0, 0, -2.0)),
        Shape(lambda p: np.linalg.norm(p - DOWN, axis=-1) - 2.0),
        lambda x, y: (x, y, np.sqrt(4.0 - x * x - y * y) - 2.0),
    ),
    "bowl": (
        lambda: rk.Ellipsoid((2.0, 2.5, 1.8), inside=True),
        Shape(lambda p: -_ellipsoid(p, 2.0, 2.5, 1.8)),
        lambda x, y: (x, y, -1.8 * np.sqrt(1 - (x / 2.0) ** 2 - (y / 2.5) ** 2)),
    ),
    "roller": (
        lambda: rk.Cylinder(1.5),
        Shape(lambda p: np.hypot(p[..., 0], p[..., 1]) - 1.5),
        lambda x, y: (1.5 * np.cos(x), 1.5 * np.sin(x), y),
    ),
    "funnel": (
        lambda: rk.Cone(0.6, inside=True),
        Shape(
            lambda p: (
                (p[..., 2] - 0.6 * np.hypot(p[..., 0], p[..., 1])) / np.hypot(1, 0.6)
            )
        ),
        lambda x, y: (2.0 + x, y, 0.6 * np.hypot(2.0 + x, y)),
    ),
    "hills": (
        lambda: rk.Graph(
            lambda x, y: 0.15 * jnp.sin(1.3 * x) * jnp.cos(1.1 * y) + 0.04 * x,
            domain=((-3.0, 3.0), (-3.0, 3.0)),
        ),
        Shape(lambda p: p[..., 2] - _hills(p[..., 0], p[..., 1])),
        lambda x, y: (x, y, _hills(x, y)),
    ),
    "tyre": (
        lambda: rk.Torus(3.0, 1.0),
        Shape(lambda p: ring(p, 3.0) - 1.0),
        lambda x, y: (
            (3.0 + np.sin(y)) * np.cos(x),
            (3.0 + np.sin(y)) * np.sin(x),
            np.cos(y),
        ),
    ),
    "hoop": (
        lambda: rk.Ring(1.5),
        Shape(lambda p: ring(p, 1.5), edge=True),
        lambda x, y: (1.5 * np.cos(x), 1.5 * np.sin(x), 0.0),
    ),
}
LAWS: dict[str, Callable] = {
    "rolling": rk.Rolling,
    "rubber": rk.RubberRolling,
    "viscous": lambda: rk.Slipping(rk.ViscousFriction(0.8)),
    "coulomb": lambda: rk.Slipping(rk.CoulombFriction(0.25, 0.05)),
    "stribeck": lambda: rk.Slipping(rk.StribeckFriction(0.4, 0.2, 0.5, 0.1, 0.05)),
}


def _swaying(t):
    x, y, z = jnp.sin(2.0 * t), jnp.cos(3.0 * t), jnp.sin(t)
    return jnp.stack([0.1 * x, 0.05 * y, 0.04 * z])


def _rocking(t):
    a, b = 0.2 * jnp.sin(1.5 * t), 0.3 * t
    c, s = jnp.cos(a), jnp.sin(a)
    tilt = jnp.asarray([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    c, s = jnp.cos(b), jnp.sin(b)
    return jnp.asarray([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ tilt


MOTIONS: dict[str, Callable] = {
    "rest": lambda: None,
    "spin": lambda: rk.Spin(1.2),
    "sway": lambda: rk.BaseMotion(position=_swaying),
    "rock": lambda: rk.BaseMotion(position=_swaying, rotation=_rocking),
}
GRAVITY = np.array([0.3, -0.2, -9.81])
MASS, CENTER = 1.7, np.array([0.03, -0.02, 0.04])
INERTIA = np.array([[0.09, 0.004, -0.002], [0.004, 0.11, 0.003], [-0.002, 0.003, 0.13]])


def scene_of(law: str, body: str, base: str, motion: str) -> rk.Scene:
    solid = rk.Body(MASS, INERTIA, BODIES[body][0](), CENTER)
    ground = rk.Base(BASES[base][0](), MOTIONS[motion]())
    return rk.Scene(solid, ground, loads=(rk.Gravity(GRAVITY),), contact=LAWS[law]())


def start_of(scene: rk.Scene, base: str, seed: int, inside: tuple = ()):
    """The first of some random starts that ``place`` accepts.

    Args:
        scene: What is placed.
        base: On what, by its name.
        seed: Of the starts.
        inside: Coordinates of what is carried, and their rates.
    """
    draw = np.random.default_rng(seed)
    for _ in range(40):
        q = draw.normal(size=4)
        options: dict = {}
        if base == "hoop":
            x = draw.uniform(-3, 3)
            lean = draw.uniform(-0.5, 1.2)
            out = np.cos(lean) * np.cos(x), np.cos(lean) * np.sin(x), np.sin(lean)
            options["base_normal"] = out
            at = BASES[base][2](x, 0.0)
        else:
            at = BASES[base][2](*draw.uniform(-0.5, 0.5, 2))
        if isinstance(scene.contact, rk.Slipping):
            options["slip"] = draw.normal(size=3)
        spin = draw.normal(size=3) * 1.5
        with contextlib.suppress(rk.FieldError), warnings.catch_warnings():
            # a base that rocks, or a start high up in a bowl, may pull
            warnings.simplefilter("ignore", UserWarning)
            q = q / np.linalg.norm(q)
            return rk.place(scene, q, spin, at, *inside, **options)
    raise AssertionError("no start was accepted")


class Found(NamedTuple):
    """What a motion was found to do.

    Attributes:
        completed: Whether it reached its last time.
        residuals: By name, of their size.
        jump: Largest step of the contact over 1.5 of its neighbours'.
        depth: Deepest place of the body in its base [m].
        depth_at_start: The same at the first time.
        middle: How many times the residuals are of.
        left_out: How many times there are besides, in blows that no stencil resolves.
    """

    completed: bool
    residuals: dict[str, float]
    jump: float
    depth: float
    depth_at_start: float
    middle: int
    left_out: int


def examined(scene: rk.Scene, start: Any, law: str, body: str, base: str) -> Found:
    """Run a scene and check it by its outputs, by as short stencils as it takes."""
    shapes = BODIES[body][1], BASES[base][1]

    def part(begin: float, step: float) -> list[Found]:
        found = _window(scene, start, law, shapes, begin, step)
        if found is None:
            return []
        shorter = 0.5 * step
        if max(found.residuals.values()) < RESIDUAL or shorter < SHORTEST:
            return [found]
        return part(begin, shorter) + part(begin + COUNT * shorter, shorter)

    return _worst(part(0.0, LONGEST))


def _window(scene, start, law, shapes, begin: float, step: float) -> Found | None:
    """A part of a motion; None where it had ended."""
    times = np.concatenate([[0.0], begin + step * np.arange(1, COUNT + 1)])
    run = rk.simulate(scene, start, times, rtol=3e-13, atol=1e-14)
    out = outputs(run)
    whole = int(np.isfinite(out["energy"]).sum())
    at_start = Seen({k: x[:1] for k, x in out.items()}, step, *shapes).depths()[0]
    out = {name: x[1:whole] for name, x in out.items()}
    if whole < 13:
        return None
    seen = Seen(out, step, *shapes)
    keep = seen.without_corners(law)
    if step < 2.0 * SHORTEST:
        keep &= seen.resolved()
    residuals = seen.mechanics(law, keep) | seen.shapes()
    count = int(keep.sum())
    numbers = seen.jump(), max(seen.depths()), at_start, count, whole - 9 - count
    return Found(bool(run.succeeded), residuals, *numbers)


def outputs(run: rk.Trajectory) -> dict[str, np.ndarray]:
    """What a run gives out, by the names that ``to_xarray`` has."""
    names = ["position", "orientation", "angular_velocity", "contact_on_body"]
    names += ["contact_on_base", "contact_force", "energy"]
    moves, slips = run.scene.base.motion is not None, hasattr(run.state, "slip")
    names += ["base_position", "base_rotation"] * moves + ["slip"] * slips
    names += ["power"] * (moves or run.scene.does_work)
    return {k: np.asarray(x) for k, x in _outputs(run, tuple(names)).items()}


@eqx.filter_jit
def _outputs(run: rk.Trajectory, names: tuple[str, ...]) -> dict:
    return {name: getattr(run, name) for name in names}


def _worst(found: list[Found]) -> Found:
    names = [name for x in found for name in x.residuals]
    return Found(
        all(x.completed for x in found),
        {name: max(x.residuals.get(name, 0.0) for x in found) for name in names},
        max(x.jump for x in found),
        max(x.depth for x in found),
        found[0].depth_at_start,
        sum(x.middle for x in found),
        sum(x.left_out for x in found),
    )


class Seen:
    """Outputs and their derivatives, at the middles of stencils."""

    def __init__(self, out, step: float, body: Shape, base: Shape):
        """Take outputs by their names, the time between them [s], and two shapes."""
        self.out, self.step, self.body, self.base = out, step, body, base
        moves = "base_rotation" in out
        self.R = _matrices(out["orientation"])
        self.A = (
            out["base_rotation"] if moves else np.broadcast_to(np.eye(3), self.R.shape)
        )
        origin = out["base_position"] if moves else 0.0 * out["position"]
        turned = np.einsum("tij,tj->ti", self.A, out["contact_on_base"])
        self.origin, self.contact = origin, origin + turned
        self.middle = slice(4, -4)
        # normal out of the body, fixed axes
        if base.edge:
            own = body.normal(out["contact_on_body"])
            self.outwards = np.einsum("tij,tj->ti", self.R, own)
        else:
            other = base.normal(out["contact_on_base"])
            self.outwards = -np.einsum("tij,tj->ti", self.A, other)

    def first(self, values):
        return self._stencil(values, FIRST) / self.step

    def second(self, values):
        return self._stencil(values, SECOND) / self.step**2

    @staticmethod
    def _stencil(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        count = len(values) - 8
        return sum(w * values[k : k + count] for k, w in enumerate(weights))

    def mechanics(self, law: str, keep: np.ndarray) -> dict[str, float]:
        """Newton, Euler, constraint, friction, power; of the sizes of their terms."""
        if not keep.any():
            return {}
        o, m = self.out, self.middle
        R, w, force = self.R, o["angular_velocity"], o["contact_force"]
        center = o["position"] + R @ CENTER
        pull = MASS * self.second(center) - MASS * GRAVITY
        size = np.abs(force[m]).max() + MASS * 10
        found = {"Newton": np.abs(pull - force[m])[keep].max() / size}
        spin = np.einsum("tij,jk,tlk,tl->ti", R, INERTIA, R, w)
        arm = (self.contact - center)[m]
        torque = self.first(spin) - np.cross(arm, force[m])
        out = self.outwards[m]
        if law == "rubber":  # and a torque about the normal, whatever it needs
            torque -= out * (torque * out).sum(1, keepdims=True)
        lever = np.abs(arm).max() * size
        found["Euler"] = np.abs(torque)[keep].max() / lever
        turning = self.first(R) @ np.swapaxes(R[m], 1, 2)
        own = np.stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]], axis=1)
        fast = 1.0 + np.abs(w).max()
        found["turning"] = np.abs(own - w[m])[keep].max() / fast
        slip = self.slip()
        asked = o["slip"][m] if "slip" in o else 0.0
        found["slip"] = np.abs(slip - asked)[keep].max() / fast
        if law == "rubber":
            relative = w[m] - self.base_turn()
            found["spin"] = np.abs((relative * out).sum(1))[keep].max() / fast
        if "slip" in o:
            found |= self.friction(law, slip[keep], force[m][keep], out[keep])
        power = o["power"][m] if "power" in o else 0.0
        heat = np.abs(power).max() + np.abs(o["energy"]).max() + 1.0
        found["power"] = np.abs(self.first(o["energy"]) - power)[keep].max() / heat
        return found

    def without_corners(self, law: str) -> np.ndarray:
        """Which stencils a motion is smooth within.

        Dry friction has the size of the normal force, whatever its sign: where a
        contact begins to pull, accelerations have a corner.
        """
        press = -(self.out["contact_force"] * self.outwards).sum(1)
        spans = np.lib.stride_tricks.sliding_window_view(press > 0.0, 9)
        whole = spans.all(axis=1) | ~spans.any(axis=1)
        return whole if law in ("coulomb", "stribeck") else np.ones_like(whole)

    def resolved(self) -> np.ndarray:
        """Where stencils of seven and of nine points agree."""
        o, R = self.out, self.R
        center = o["position"] + R @ CENTER
        spin = np.einsum("tij,jk,tlk,tl->ti", R, INERTIA, R, o["angular_velocity"])
        found = []
        for values, seven, nine in (
            (center, SECOND_OF_7, SECOND),
            (spin, FIRST_OF_7, FIRST),
        ):
            limit = RESIDUAL * np.abs(self._stencil(values, nine)).max()
            limit += 1e-14 * np.abs(values).max()  # a hundred roundings
            apart = np.abs(self._stencil(values, seven - nine))
            found.append((apart < limit).all(axis=1))
        return np.logical_and.reduce(found)

    def base_turn(self) -> np.ndarray:
        turning = self.first(self.A) @ np.swapaxes(self.A[self.middle], 1, 2)
        return np.stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]], axis=1)

    def slip(self) -> np.ndarray:
        """Velocity of the body's point at the contact over the base's."""
        m = self.middle
        w, arm = (
            self.out["angular_velocity"][m],
            (self.contact - self.out["position"])[m],
        )
        body = self.first(self.out["position"]) + np.cross(w, arm)
        base = self.first(self.origin) + np.cross(
            self.base_turn(), (self.contact - self.origin)[m]
        )
        return body - base

    def friction(self, law: str, slip, force, out) -> dict[str, float]:
        """The part along the surface, by the law as it is written in books."""
        press = -(force * out).sum(1)
        along = force + press[:, None] * out
        speed = np.linalg.norm(slip, axis=1)
        regular = np.sqrt(speed**2 + 0.05**2)
        if law == "viscous":
            wanted = -0.8 * slip
        elif law == "coulomb":
            wanted = -(0.25 * np.abs(press) / regular)[:, None] * slip
        else:
            mu = 0.2 + 0.2 * np.exp(-((speed / 0.5) ** 2))
            wanted = -(mu * np.abs(press) / regular + 0.1)[:, None] * slip
        return {"friction": np.abs(along - wanted).max() / (np.abs(force).max() + 1.0)}

    def shapes(self) -> dict[str, float]:
        """The contact lies on both surfaces, and their normals are opposite."""
        body, base = self.body, self.base
        on_body, on_base = self.out["contact_on_body"], self.out["contact_on_base"]
        found = {
            "on body": np.abs(body.level(on_body)).max(),
            "on base": np.abs(base.level(on_base)).max(),
        }
        if not (body.edge or base.edge):
            there = np.einsum("tij,tj->ti", self.R, body.normal(on_body))
            here = np.einsum("tij,tj->ti", self.A, base.normal(on_base))
            found["normals"] = np.abs(there + here).max()
        return found

    def jump(self) -> float:
        """Largest step of the contact on either surface over 1.5 of those around it."""
        worst = 0.0
        for path in (self.out["contact_on_body"], self.out["contact_on_base"]):
            steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
            around = np.maximum(steps[:-2], steps[2:])
            least = 1e-3 * self.step  # of a contact that hardly moves
            worst = max(worst, (steps[1:-1] / (1.5 * np.maximum(around, least))).max())
        return worst

    def depths(self) -> list[float]:
        """Deepest of the body's points in its base [m]; a wire has no inside."""
        if self.base.edge:
            return [0.0]
        assert self.body.points is not None
        found = []
        for k in range(0, len(self.R), 10):
            at = self.out["position"][k] + self.body.points @ self.R[k].T
            level = self.base.level((at - self.origin[k]) @ self.A[k])
            found.append(-float(level.min()))
        return found


def _matrices(q: np.ndarray) -> np.ndarray:
    a, b, c, d = q.T
    rows = [
        [1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
