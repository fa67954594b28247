"""Rigid bodies that roll on one another, by Newton, Euler and multipliers, in NumPy.

A second way to the same motions, with nothing of rollkane: every body has a position, a
rotation matrix, velocities of its mass centre and an angular velocity, all on FIXED
axes; every contact a point on each of its two surfaces and three multipliers, the
force. Surfaces are ellipsoids and cylinders (from inside or outside) and planes, by
their level functions, and rims. Free particles hang on springs from points of bodies.
"""

import dataclasses

import numpy as np
from scipy.integrate import solve_ivp


@dataclasses.dataclass
class Quadric:
    """``side (sum (p_i / a_i)^2 - 1) / 2 = 0``; side 1: material inside, -1: outside.

    A plane z = 0 where there are no semi-axes, a cylinder where one is infinite.
    ``place`` and ``turn`` put its axes into the body's: p_body = place + turn p.
    """

    semi_axes: np.ndarray | None = None
    side: float = 1.0
    place: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    turn: np.ndarray = dataclasses.field(default_factory=lambda: np.eye(3))

    def normal_and_shape(self, point):
        """Outward unit normal and shape operator at a point, body axes."""
        if self.semi_axes is None:
            return self.turn[:, 2], np.zeros((3, 3))
        p = self.turn.T @ (point - self.place)
        weights = self.side / self.semi_axes**2
        gradient = weights * p
        size = np.linalg.norm(gradient)
        n = gradient / size
        across = np.eye(3) - np.outer(n, n)
        shape = across @ np.diag(weights) @ across / size
        return self.turn @ n, self.turn @ shape @ self.turn.T


@dataclasses.dataclass
class Rim:
    """A circle about z, which touches by its edge: its normal is the carrier's."""

    radius: float

    def pace(self, point, R, N, Sc, turning):
        """Velocity of the contact over it: the tangent stays across the normal.

        With e out along the radius and s the speed, T' = w x T - (s / r) e and
        N' = w_c x N - Sc s T, of which N . T' + N' . T = 0.
        """
        e = point / self.radius
        out, T = R @ e, R @ np.cross(np.eye(3)[2], e)
        return T @ turning / (T @ Sc @ T + N @ out / self.radius) * T


@dataclasses.dataclass
class Rigid:
    """A body: mass, inertia about its mass centre, mass centre from its origin."""

    mass: float
    inertia: np.ndarray
    center: np.ndarray


@dataclasses.dataclass
class Touch:
    """A contact: ``body`` rolls by ``own`` on ``base`` of ``carrier`` (-1: ground)."""

    carrier: int
    base: Quadric
    body: int
    own: Quadric | Rim
    rubber: bool = False  # no spin about the normal, by a fourth multiplier: a torque


@dataclasses.dataclass
class Hung:
    """A particle on a spring from the origin of a body, isotropic [N/m]."""

    body: int
    mass: float
    stiffness: float


def cross_matrix(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


@dataclasses.dataclass
class Model:
    """Bodies, contacts and particles under gravity, over a ground that may move."""

    bodies: list
    touches: list
    hung: list
    gravity: np.ndarray
    ground: object  # t -> position, rotation, velocity, w, acceleration, w'

    def split(self, y):
        n, m, h = len(self.bodies), len(self.touches), len(self.hung)
        sizes = [3 * n, 9 * n, 3 * n, 3 * n, 3 * m, 3 * m, 3 * h, 3 * h]
        parts = np.split(y, np.cumsum(sizes)[:-1])
        return (
            parts[0].reshape(n, 3),
            parts[1].reshape(n, 3, 3),
            parts[2].reshape(n, 3),
            parts[3].reshape(n, 3),
            parts[4].reshape(m, 3),  # on the carrier
            parts[5].reshape(m, 3),  # on the body
            parts[6].reshape(h, 3),
            parts[7].reshape(h, 3),
        )

    def rates(self, t, y):
        r, R, v, w, on_base, on_body, x, vx = self.split(y)
        n, m = len(self.bodies), len(self.touches)
        ground = self.ground(t)
        M = np.zeros((6 * n, 6 * n))
        F = np.zeros(6 * n)
        for k, body in enumerate(self.bodies):
            inertia = R[k] @ body.inertia @ R[k].T
            M[6 * k : 6 * k + 3, 6 * k : 6 * k + 3] = body.mass * np.eye(3)
            M[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6] = inertia
            F[6 * k : 6 * k + 3] = body.mass * self.gravity
            F[6 * k + 3 : 6 * k + 6] = -np.cross(w[k], inertia @ w[k])
        ax = np.zeros_like(x)
        for k, part in enumerate(self.hung):
            origin = r[part.body] - R[part.body] @ self.bodies[part.body].center
            pull = -part.stiffness * (x[k] - origin)
            ax[k] = pull / part.mass + self.gravity
            first = 6 * part.body
            F[first : first + 3] -= pull
            F[first + 3 : first + 6] -= np.cross(origin - r[part.body], pull)
        spins = [k for k, touch in enumerate(self.touches) if touch.rubber]
        count = 3 * m + len(spins)
        J, known = np.zeros((count, 6 * n)), np.zeros(count)
        base_rates, body_rates = np.zeros_like(on_base), np.zeros_like(on_body)
        for k, touch in enumerate(self.touches):
            b, c = touch.body, touch.carrier
            center = self.bodies[b].center
            arm = R[b] @ (on_body[k] - center)
            if c < 0:
                Rc, wc = ground[1], ground[3]
                arm_c = Rc @ on_base[k]
            else:
                Rc, wc = R[c], w[c]
                arm_c = Rc @ (on_base[k] - self.bodies[c].center)
            normal, Sc = touch.base.normal_and_shape(on_base[k])
            N, Sc = -Rc @ normal, Rc @ Sc @ Rc.T
            if isinstance(touch.own, Rim):
                turning = np.cross(N, w[b] - wc)
                V = touch.own.pace(on_body[k], R[b], N, Sc, turning)
            else:
                normal, S = touch.own.normal_and_shape(on_body[k])
                N, S = R[b] @ normal, R[b] @ S @ R[b].T
                whole = S + Sc + np.outer(N, N)
                V = np.linalg.solve(whole, np.cross(N, w[b] - wc))
            base_rates[k], body_rates[k] = Rc.T @ V, R[b].T @ V
            if k in spins:
                row = 3 * m + spins.index(k)
                J[row, 6 * b + 3 : 6 * b + 6] = N
                turn = np.cross(w[b], N) + S @ V  # of the normal
                known[row] -= (w[b] - wc) @ turn
                if c < 0:
                    known[row] += N @ ground[5]
                else:
                    J[row, 6 * c + 3 : 6 * c + 6] = -N
            rows = slice(3 * k, 3 * k + 3)
            J[rows, 6 * b : 6 * b + 3] = np.eye(3)
            J[rows, 6 * b + 3 : 6 * b + 6] = -cross_matrix(arm)
            # d/dt (v + w x arm), the contact moving by V over both materials
            known[rows] -= np.cross(w[b], V + np.cross(w[b], arm))
            known[rows] += np.cross(wc, V + np.cross(wc, arm_c))
            if c < 0:
                known[rows] += ground[4] + np.cross(ground[5], arm_c)
            else:
                J[rows, 6 * c : 6 * c + 3] = -np.eye(3)
                J[rows, 6 * c + 3 : 6 * c + 6] = cross_matrix(arm_c)
        zero = np.zeros((count, count))
        both = np.block([[M, -J.T], [J, zero]])
        found = np.linalg.solve(both, np.concatenate([F, known]))
        a = found[: 6 * n].reshape(n, 6)
        turns = np.array([cross_matrix(w[k]) @ R[k] for k in range(n)])
        parts = v, turns, a[:, :3], a[:, 3:], base_rates, body_rates, vx, ax
        rates = np.concatenate([part.ravel() for part in parts])
        return rates, found[6 * n : 6 * n + 3 * m].reshape(m, 3)

    def run(self, y, times):
        """States at the times; errors of a step 1e-13 of the numbers."""
        options = {"rtol": 1e-13, "atol": 1e-14, "method": "DOP853", "t_eval": times}
        right = lambda t, y: self.rates(t, y)[0]
        run = solve_ivp(right, (times[0], times[-1]), y, **options)
        assert run.success
        return run.y.T


def still(t):
    """A ground at rest."""
    zero = np.zeros(3)
    return zero, np.eye(3), zero, zero, zero, zero
