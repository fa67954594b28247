"""Random scenes in which bodies roll on or in the rolling body, and their twins."""

import dataclasses

import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.geometry.rotations import rotation_matrix

from .pairs_by_newton import Hung, Model, Quadric, Rigid, Rim, Touch, still

GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclasses.dataclass
class Rolls:
    """A body by its semi-axes, and the surface of its carrier on which it rolls.

    ``on`` is (semi-axes or None: a plane, side: -1 from inside), a cylinder where one
    is infinite; ``rim`` says whether the body touches by an edge, of a radius,
    ``particle`` whether a particle hangs in it on a spring, ``tilted`` whether the
    surface has a place and axes of its own in the carrier.
    """

    body: object
    mass: float
    on: tuple = (None, 1.0)
    inner: tuple = ()
    rubber: bool = False
    particle: bool = False
    tilted: bool = False
    rim: bool = False


KINDS = {
    "ball in shell on plane": Rolls(
        0.3, 1.0, inner=(Rolls(0.1, 0.7, (0.28, -1.0), tilted=True),)
    ),
    "ball on ball on turntable": Rolls(0.2, 1.0, inner=(Rolls(0.15, 0.5, (0.2, 1.0)),)),
    "ellipsoid in bowl in bowl": Rolls(
        (0.3, 0.28, 0.32),
        1.5,
        (1.0, -1.0),
        inner=(Rolls((0.1, 0.105, 0.11), 0.4, (0.25, -1.0), particle=True),),
    ),
    "egg in a rocking cavity": Rolls(
        (0.2, 0.2, 0.25),
        0.8,
        ((0.9, 1.0, 1.1), -1.0),
        inner=(Rolls(0.05, 0.3, ((0.16, 0.15, 0.17), -1.0)),),
        particle=True,
    ),
    "disc in a hoop": Rolls(
        0.3,
        1.0,
        inner=(Rolls(0.1, 0.4, ((0.28, 0.28, np.inf), -1.0), rim=True),),
    ),
    "ball in shell in shell": Rolls(
        0.4,
        1.0,
        inner=(
            Rolls(
                0.25,
                0.6,
                (0.38, -1.0),
                tilted=True,
                inner=(Rolls(0.08, 0.3, (0.24, -1.0)),),
            ),
        ),
    ),
    "two balls in a shell": Rolls(
        0.4,
        1.0,
        inner=(Rolls(0.1, 0.3, (0.38, -1.0)), Rolls(0.08, 0.2, (0.38, -1.0))),
    ),
    "rubber ball in rubber shell": Rolls(
        0.3,
        1.0,
        rubber=True,
        inner=(Rolls((0.1, 0.11, 0.1), 0.5, (0.29, -1.0), rubber=True, particle=True),),
    ),
}

# so chaotic (1e-9 rad/s at the start are 1e-5 m after 5 s) that two runs of the same
# scene, at rtol 1e-12 and 1e-13, part by 1e-8 m by then
CHAOTIC = {"ball in shell in shell": 3.0}
# of the first draws those in which the disc does not lie down
SEEDS = {"disc in a hoop": (1, 2, 4, 5)}
SPIN = 0.8  # of the turntable [rad/s]
# of gravity: as a wheel does, a disc stays upright by its spin, in a weak field longer;
# where it lies down it comes to fit the hoop, and no motion goes on from there
LIGHT = {"disc in a hoop": 0.1}
SPEED = 10.0  # of the disc [rad/s]


def rocking(t):
    """Rotation of a rocking base: about x, by 0.2 sin(1.3 t)."""
    angle = 0.2 * jnp.sin(1.3 * t)
    c, s, one, zero = jnp.cos(angle), jnp.sin(angle), jnp.ones(()), jnp.zeros(())
    rows = [[one, zero, zero], [zero, c, -s], [zero, s, c]]
    return jnp.stack([jnp.stack(row) for row in rows])


def swaying(t):
    return 0.05 * jnp.stack([jnp.sin(2.0 * t), jnp.zeros(()), jnp.zeros(())])


def rocking_ground(t):
    """The same for the twin, with its rates."""
    angle, x = 0.2 * np.sin(1.3 * t), np.eye(3)[0]
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    rate, second = 0.26 * np.cos(1.3 * t), -0.338 * np.sin(1.3 * t)
    moved = 0.05 * np.sin(2.0 * t), 0.1 * np.cos(2.0 * t), -0.2 * np.sin(2.0 * t)
    return moved[0] * x, turn, moved[1] * x, rate * x, moved[2] * x, second * x


def turning_ground(t):
    """A turntable for the twin."""
    c, s = np.cos(SPIN * t), np.sin(SPIN * t)
    zero, turn = np.zeros(3), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return zero, turn, zero, np.array([0, 0, SPIN]), zero, zero


MOTIONS = {
    "ball on ball on turntable": (rk.Spin(SPIN), turning_ground),
    "egg in a rocking cavity": (rk.BaseMotion(swaying, rocking), rocking_ground),
}


def own_place(alpha, stiffness):
    """A particle with its place in the body as coordinates."""
    del stiffness
    return alpha[None]


def stored(alpha, stiffness):
    return 0.5 * stiffness * jnp.sum(alpha * alpha)


def surface_of(semi_axes, side=1.0):
    if semi_axes is None:
        return rk.Plane()
    inside = side < 0
    if np.any(np.isinf(semi_axes)):
        return rk.Cylinder(semi_axes[0], inside=inside)
    if np.ndim(semi_axes) == 0:
        return rk.Sphere(semi_axes, inside=inside)
    return rk.Ellipsoid(semi_axes, inside=inside)


def unit(draw, n):
    v = draw.normal(size=n)
    return v / np.linalg.norm(v)


class Pairs:
    """A scene of a kind with random numbers, its start, and its twin.

    Attributes:
        scene: In rollkane.
        start: Its start.
        paths: Of the twin's bodies: () is the rolling body itself.
        surfaces: Of each contact: the body's own, and what it rolls on.
        model: The twin.
    """

    def __init__(self, kind, seed):
        """Draw the numbers."""
        self.draw = np.random.default_rng(seed)
        self.bodies, self.touches, self.hung, self.paths = [], [], [], []
        self.surfaces = []
        motion, ground = MOTIONS.get(kind, (None, still))
        spec = KINDS[kind]
        body, parts, inner = self._made(spec, -1, ())
        base = rk.Base(surface_of(*spec.on), motion)
        law = rk.RubberRolling() if spec.rubber else rk.Rolling()
        gravity = LIGHT.get(kind, 1.0) * GRAVITY
        self.scene = rk.Scene(body, base, parts, (rk.Gravity(gravity),), law)
        point = self._point(*spec.on)
        self.start = rk.place(
            self.scene,
            unit(self.draw, 4),
            0.5 * self.draw.normal(size=3),
            point,
            *self._hanging(spec),
            supported=inner,
            allow_overlap=True,
        )
        self.model = Model(self.bodies, self.touches, self.hung, gravity, ground)

    def _made(self, spec, carrier, path):
        """A body, what it carries, and the states of those that roll on it."""
        draw, index = self.draw, len(self.bodies)
        size = np.min(spec.body)
        turn = np.asarray(rotation_matrix(jnp.asarray(unit(draw, 4))))
        second = np.diag(spec.mass * size**2 * draw.uniform(0.1, 0.2, 3))
        if spec.rim:  # flat, so that it is steady as a wheel
            second, turn = second * np.diag([2.0, 2.0, 0.1]), np.eye(3)
        inertia = turn @ (np.trace(second) * np.eye(3) - second) @ turn.T
        center = (0.02 if spec.rim else 0.15) * size * draw.uniform(-1.0, 1.0, 3)
        self.bodies.append(Rigid(spec.mass, inertia, center))
        self.paths.append(path)
        axes, side = spec.on
        base = Quadric(None if axes is None else axes * np.ones(3), side)
        own = Rim(spec.body) if spec.rim else Quadric(spec.body * np.ones(3))
        self.touches.append(Touch(carrier, base, index, own, spec.rubber))
        surface = rk.DiscEdge(spec.body) if spec.rim else surface_of(spec.body)
        body = rk.Body(spec.mass, inertia, surface, center)
        self.surfaces.append((surface, surface_of(*spec.on)))
        parts, states = [], []
        if spec.particle:
            stiffness = 40.0
            self.hung.append(Hung(index, 0.1, stiffness))
            parts.append(
                rk.PointMasses(
                    0.1,
                    own_place,
                    potential=stored,
                    parameters=stiffness,
                    coordinates=3,
                )
            )
        for k, inner in enumerate(spec.inner):
            part, state = self._rolling(inner, index, (*path, k))
            parts.append(part)
            states.append(state)
        return body, tuple(parts), tuple(states)

    def _rolling(self, spec, carrier, path):
        """A ``RollingBody`` and its state."""
        index, where = len(self.bodies), {}
        body, parts, inner = self._made(spec, carrier, path)
        if spec.tilted:
            q, place = unit(self.draw, 4), 0.01 * self.draw.normal(size=3)
            where = {"position": place, "rotation": q}
            base = self.touches[index].base
            base.place, base.turn = place, np.asarray(rotation_matrix(jnp.asarray(q)))
        law = rk.RubberRolling() if spec.rubber else rk.Rolling()
        part = rk.RollingBody(body, surface_of(*spec.on), parts, law, **where)
        turn = unit(self.draw, 4)
        if spec.rim:  # its axis near that of the hoop, else it lies down
            turn = turn + 30.0 * np.eye(4)[0]
            turn = turn / np.linalg.norm(turn)
        w = 0.5 * self.draw.normal(size=3)
        if spec.rim:
            w = w + SPEED * np.eye(3)[2]
        state = part.place(
            turn,
            w,
            self._point(*spec.on),
            *self._hanging(spec),
            supported=inner,
        )
        return part, state

    def _point(self, axes, side):
        """A point of a surface, near the bottom of a bowl or the top of a ball.

        From high up a bowl motions are so fast and chaotic that in five seconds no two
        integrations agree to 1e-9.
        """
        if axes is None:
            return np.zeros(3)
        direction = np.array([*self.draw.uniform(-0.3, 0.3, 2), side])
        if np.any(np.isinf(axes)):  # about z: on the circle where z is zero
            direction = np.array([self.draw.uniform(-0.3, 0.3), side, 0.0])
            axes = np.where(np.isinf(axes), 0.0, axes)
        return axes * direction / np.linalg.norm(direction)

    def _hanging(self, spec):
        if not spec.particle:
            return (), ()
        return 0.02 * self.draw.normal(size=3), 0.1 * self.draw.normal(size=3)

    def motion_of(self, result, path):
        """Outputs of a body."""
        return result.rolling_body(*path) if path else result

    def twin_start(self, result):
        """The twin's state at the first time, by the outputs of a run."""
        r, R, v, w, on_base, on_body = ([] for _ in range(6))
        for body, path, touch in zip(
            self.bodies, self.paths, self.touches, strict=True
        ):
            seen = self.motion_of(result, path)
            turn = np.asarray(rotation_matrix(jnp.asarray(seen.orientation[0])))
            arm = turn @ body.center
            r.append(seen.position[0] + arm)
            R.append(turn)
            w.append(seen.angular_velocity[0])
            v.append(seen.velocity[0] + np.cross(w[-1], arm))
            on_body.append(seen.contact_on_body[0])
            point = seen.contact_on_carrier[0] if path else seen.contact_on_base[0]
            base = touch.base
            on_base.append(base.place + base.turn @ point)
        x, vx = [], []
        for part in self.hung:
            state = result.state
            for k in self.paths[part.body]:
                state = state.supported[k]
            arm = R[part.body] @ (state.alpha[0] - self.bodies[part.body].center)
            x.append(r[part.body] + arm)
            turned = np.cross(w[part.body], arm)
            vx.append(v[part.body] + turned + R[part.body] @ state.alpha_dot[0])
        parts = r, R, v, w, on_base, on_body, x, vx
        return np.concatenate([np.ravel(part) for part in parts])
