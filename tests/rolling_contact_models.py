"""Systems whose bodies roll on each other, for the tests of contacts."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane import kane
from rollkane.geometry.rotations import about_axis
from rollkane.geometry.small_linear import cross

G = 9.81
TO_Y = np.asarray(about_axis(0, jnp.asarray(-np.pi / 2)))  # z of an axle to y
FLIPPED = np.diag([1.0, -1.0, -1.0])


class Plate(eqx.Module):
    """Axes of a plate that moves along x and turns about a vertical axis."""

    velocity: jnp.ndarray
    rate: jnp.ndarray
    at: jnp.ndarray
    side: jnp.ndarray

    def position(self, t):
        return self.at + t * self.velocity * jnp.array([1.0, 0.0, 0.0])

    def rotation(self, t):
        return about_axis(2, self.rate * t) @ self.side


class Placed(eqx.Module):
    plate: Plate

    def __call__(self, t, q, u):
        return self.plate.position(t)


class Turned(eqx.Module):
    plate: Plate

    def __call__(self, t, q, u):
        return self.plate.rotation(t)


def plate(velocity, rate, at, side):
    made = Plate(*(jnp.asarray(x, float) for x in (velocity, rate, at, side)))
    return kane.Frame(Placed(made), Turned(made))


class Fixed(eqx.Module):
    rotation: jnp.ndarray

    def __call__(self, t, q, u):
        return self.rotation


def at_rest(rotation):
    return kane.Frame(None, Fixed(jnp.asarray(rotation)))


class EndOf(eqx.Module):
    """A point on the axis of a body, z."""

    frame: kane.Frame
    along: float = eqx.field(static=True)

    def __call__(self, t, q, u):
        place = self.frame.position(t, q, u)
        return place + self.along * self.frame.rotation(t, q, u)[:, 2]


def ends_of(frame, half):
    return [kane.Frame(EndOf(frame, s * half), frame.rotation) for s in (1, -1)]


def between_plates(below, above, radius, q, u, mass=2.0):
    """A homogeneous ball between two plates."""
    inertia = 0.4 * mass * radius**2 * np.eye(3)
    bodies = kane.free_bodies([mass], [inertia])
    (ball,) = bodies.frames
    contacts = [
        kane.RollingContact(ball, rk.Sphere(radius), body, rk.Plane(), name=name)
        for body, name in ((below, "below"), (above, "above"))
    ]
    return kane.rolling_contacts(bodies.system, contacts, [*q, 1, 0, 0, 0], u)


def cylinder_in_pipe(mass, radius, pipe, half, angle):
    """A solid cylinder, by its two rims, in a horizontal pipe along y."""
    inertia = np.diag([0.02, 0.02, 0.5 * mass * radius**2])
    bodies = kane.free_bodies([mass], [inertia])
    out = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    contacts = [
        kane.RollingContact(
            end,
            rk.DiscEdge(radius),
            at_rest(TO_Y),
            rk.Cylinder(pipe, inside=True),
            near=pipe * out + s * half * np.array([0.0, 1.0, 0.0]),
            name=name,
        )
        for end, s, name in zip(
            ends_of(bodies.frames[0], half),
            (1, -1),
            ("one end", "other end"),
            strict=True,
        )
    ]
    q = [*((pipe - radius) * out), np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]
    return kane.rolling_contacts(bodies.system, contacts, q, np.zeros(6))


def ball_in_tube(M, a, m, r, half, angle, speeds):
    """A thin tube along y on a plane, by its two rims, and a ball that rolls in it."""
    tube = np.diag([0.3, 0.3, M * a * a])
    bodies = kane.free_bodies([M, m], [tube, 0.4 * m * r * r * np.eye(3)])
    outer, ball = bodies.frames
    contacts = [
        kane.RollingContact(end, rk.DiscEdge(a), kane.ground, rk.Plane())
        for end in ends_of(outer, half)
    ]
    inner = rk.Cylinder(a, inside=True)
    contacts.append(kane.RollingContact(ball, rk.Sphere(r), outer, inner))
    c = (a - r) * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    q = [0, 0, a, np.sqrt(0.5), -np.sqrt(0.5), 0, 0, c[0], 0, a + c[2], 1, 0, 0, 0]
    return kane.rolling_contacts(bodies.system, contacts, q, speeds)


def cylinder_in_tube(M, a, m, r, half):
    """A thin tube along y on a plane, and a solid cylinder at rest in it, by rims."""
    tube, solid = np.diag([0.3, 0.3, M * a * a]), np.diag([0.02, 0.02, m * r * r / 2])
    bodies = kane.free_bodies([M, m], [tube, solid])
    outer, cylinder = bodies.frames
    contacts = [
        kane.RollingContact(end, rk.DiscEdge(a), kane.ground, rk.Plane())
        for end in ends_of(outer, half)
    ]
    inner = rk.Cylinder(a, inside=True)
    contacts += [
        kane.RollingContact(
            end, rk.DiscEdge(r), outer, inner, near=[0.0, s * half, 0.0]
        )
        for end, s in zip(ends_of(cylinder, half), (1, -1), strict=True)
    ]
    turn = [np.sqrt(0.5), -np.sqrt(0.5), 0, 0]
    q = [0, 0, a, *turn, 0, 0, r, *turn]
    return kane.rolling_contacts(bodies.system, contacts, q, np.zeros(12))


BICYCLE = kane.Bicycle()


def _vector(x, z):
    return jnp.stack([jnp.asarray(v, float) for v in (x, 0.0, z)])


def _posture(t, q, u, p):
    """As in ``kane.whipple_bicycle``, with the rear axle anywhere: z is down.

    q = rear axle [m], yaw, lean, pitch, steer, turn of rear and of front wheel [rad].
    """
    b = BICYCLE
    heading = about_axis(2, q[3])
    lean = heading @ about_axis(0, q[4])
    frame = lean @ about_axis(1, q[5])
    tilted = about_axis(1, jnp.asarray(b.steer_tilt))
    fork = frame @ tilted @ about_axis(2, q[6]) @ tilted.T
    frame_spin = u[3] * _vector(0.0, 1.0) + u[4] * heading[:, 0] + u[5] * lean[:, 1]
    fork_spin = frame_spin + u[6] * (frame @ tilted)[:, 2]
    head = frame @ _vector(b.wheel_base + b.trail, b.rear_radius)
    return {
        "frame": frame,
        "fork": fork,
        "rear": frame @ about_axis(1, q[7]),
        "front": fork @ about_axis(1, q[8]),
        "frame spin": frame_spin,
        "fork spin": fork_spin,
        "rear spin": frame_spin + u[7] * lean[:, 1],
        "front spin": fork_spin + u[8] * fork[:, 1],
        "head": head,
        "front axle": head + fork @ _vector(-b.trail, -b.front_radius),
        "frame arm": frame
        @ _vector(b.frame_mass_center[0], b.frame_mass_center[1] + b.rear_radius),
        "fork arm": fork
        @ _vector(
            b.fork_mass_center[0] - b.wheel_base - b.trail, b.fork_mass_center[1]
        ),
    }


def _kinematics(t, q, u, p):
    return u


def _rear(t, q, u, p):
    return u[:3]


def _frame(t, q, u, p):
    return u[:3] + cross(p["frame spin"], p["frame arm"])


def _head(t, q, u, p):
    return u[:3] + cross(p["frame spin"], p["head"])


def _fork(t, q, u, p):
    return _head(t, q, u, p) + cross(p["fork spin"], p["fork arm"])


def _front(t, q, u, p):
    return _head(t, q, u, p) + cross(p["fork spin"], p["front axle"] - p["head"])


def bicycle(speed, road, tyre=0.0, lean_rate=0.0):
    """Whipple's bicycle, its wheels in contact with a road above which z is up."""
    b = BICYCLE

    def matrix(xx, yy, zz, xz):
        return np.array([[xx, 0.0, xz], [0.0, yy, 0.0], [xz, 0.0, zz]])

    def spin(axes, name):
        return lambda t, q, u, p: p[axes].T @ p[name]

    (rx, ry), (fx, fy) = b.rear_moments, b.front_moments
    parts = [
        (b.rear_mass, matrix(rx, ry, rx, 0.0), _rear, ("rear", "rear spin")),
        (b.frame_mass, matrix(*b.frame_inertia), _frame, ("frame", "frame spin")),
        (b.fork_mass, matrix(*b.fork_inertia), _fork, ("fork", "fork spin")),
        (b.front_mass, matrix(fx, fy, fx, 0.0), _front, ("front", "front spin")),
    ]
    loads = [
        kane.Load(v, lambda t, q, u, p, m=m: m * _vector(0.0, b.gravity))
        for m, _, v, _ in parts
    ]
    rigid = [kane.RigidBody(m, inertia, v, spin(*s)) for m, inertia, v, s in parts]
    base = kane.KaneSystem(9, 9, _kinematics, rigid, loads, shared=_posture)
    rear = kane.Frame(lambda t, q, u, p: q[:3], lambda t, q, u, p: p["rear"] @ TO_Y)
    front = kane.Frame(
        lambda t, q, u, p: q[:3] + p["front axle"],
        lambda t, q, u, p: p["front"] @ TO_Y,
    )

    def wheel(radius):
        return rk.Torus(radius - tyre, tyre) if tyre else rk.DiscEdge(radius)

    ground = at_rest(FLIPPED)
    contacts = [
        kane.RollingContact(rear, wheel(b.rear_radius), ground, road, name="rear"),
        kane.RollingContact(front, wheel(b.front_radius), ground, road, name="front"),
    ]
    q, u = np.zeros(9), np.zeros(9)
    q[2] = -b.rear_radius
    u[0], u[4], u[7], u[8] = speed, lean_rate, -speed / b.rear_radius, 0.0
    u[8] = -speed / b.front_radius
    free = (0, 1, 3, 4, 6, 7, 8), (4, 6, 7)
    return kane.rolling_contacts(
        *(base, contacts, q, u),
        independent_coordinates=free[0],
        independent_speeds=free[1],
    )


def bicycle_height_energy(q):
    """Potential energy of a bicycle [J]."""
    b = BICYCLE
    now = _posture(0.0, q, jnp.zeros(9), None)
    down = q[2] + jnp.stack(
        [
            0.0 * q[2],
            now["frame arm"][2],
            now["head"][2] + now["fork arm"][2],
            now["front axle"][2],
        ]
    )
    masses = jnp.array([b.rear_mass, b.frame_mass, b.fork_mass, b.front_mass])
    return -b.gravity * jnp.sum(masses * down)


def _axle(t, q, u, p):
    """A carriage: q = axle [m], yaw, bank, pitch of the body, turns of two wheels."""
    heading = about_axis(2, q[3])
    banked = heading @ about_axis(0, q[4])
    spin = u[3] * jnp.array([0.0, 0.0, 1.0]) + u[4] * heading[:, 0]
    turns = {
        name: (banked @ about_axis(1, q[k]), spin + u[k] * banked[:, 1])
        for name, k in (("body", 5), ("left", 6), ("right", 7))
    }
    return {"axle": banked[:, 1], "spin": spin, "turns": turns}


def carriage(ground, q, u, *, wheel=0.3, track=0.8, drop=0.1):
    """A body that hangs below an axle with two wheels, on any ground; z is up."""
    parts, frames, loads = [], [], []
    disc = 0.5 * 2.0 * wheel**2
    for name, mass, inertia, arm in (
        ("body", 10.0, np.diag([0.5, 0.4, 0.6]), (0.0, 0.0, -drop)),
        ("left", 2.0, np.diag([0.5 * disc, disc, 0.5 * disc]), (0.0, 0.5 * track, 0.0)),
        ("right", 2.0, np.diag([0.5 * disc, disc, 0.5 * disc]), (0, -0.5 * track, 0)),
    ):

        def velocity(t, q, u, p, name=name, arm=arm):
            turn, spin = p["turns"][name]
            return u[:3] + cross(spin, turn @ jnp.array(arm, float))

        def own(t, q, u, p, name=name):
            turn, spin = p["turns"][name]
            return turn.T @ spin

        parts.append(kane.RigidBody(mass, inertia, velocity, own))
        loads.append(
            kane.Load(velocity, lambda t, q, u, p, m=mass: _vector(0.0, -m * G))
        )
        if name != "body":
            at = lambda t, q, u, p, arm=arm: q[:3] + arm[1] * p["axle"]
            turn = lambda t, q, u, p, name=name: p["turns"][name][0] @ TO_Y
            frames.append(kane.Frame(at, turn))
    system = kane.KaneSystem(8, 8, lambda t, q, u, p: u, parts, loads, shared=_axle)
    contacts = [
        kane.RollingContact(frame, rk.DiscEdge(wheel), kane.ground, ground, name=name)
        for frame, name in zip(frames, ("left", "right"), strict=True)
    ]
    return kane.rolling_contacts(system, contacts, q, u)


def carriage_height_energy(q, drop=0.1):
    """Potential energy of a carriage [J]."""
    turn, _ = _axle(0.0, q, jnp.zeros(8), None)["turns"]["body"]
    return G * (14.0 * q[2] - 10.0 * drop * turn[2, 2])


def ball_bearing(inner, ball, rate, count=4):
    """A ring that turns on balls in a fixed race, all free; axis z."""
    out = inner + 2 * ball
    mass, heavy = 0.1, 2.0
    solid = 0.4 * mass * ball**2 * np.eye(3)
    ring = heavy * inner**2 * np.diag([0.5, 0.5, 1.0])
    masses = [heavy] + [mass] * count
    bodies = kane.free_bodies(masses, [ring] + [solid] * count, gravity=(0.0, 0.0, 0.0))
    race, *balls = bodies.frames
    contacts = []
    for k, frame in enumerate(balls):
        contacts += [
            kane.RollingContact(
                frame, rk.Sphere(ball), race, rk.Cylinder(inner), name=f"ring {k}"
            ),
            kane.RollingContact(
                frame,
                rk.Sphere(ball),
                kane.ground,
                rk.Cylinder(out, inside=True),
                name=f"race {k}",
            ),
        ]
    turns = 2 * np.pi * np.arange(count) / count
    middle = inner + ball
    q = [0, 0, 0, 1, 0, 0, 0]
    u = [0, 0, 0, 0, 0, rate]
    orbit = 0.5 * rate * inner / middle
    for a in turns:
        q += [middle * np.cos(a), middle * np.sin(a), 0, 1, 0, 0, 0]
        along = orbit * middle * np.array([-np.sin(a), np.cos(a), 0])
        u += [*along, 0, 0, -orbit * middle / ball]
    return kane.rolling_contacts(bodies.system, contacts, q, u)
