"""Rolling motions of random draws whose statistics have closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr

import rollkane as rk
from rollkane.dynamics.observables import normal_force
from rollkane.dynamics.rolling import contact_of
from rollkane.uncertainty.distributions import Normal, Uniform
from rollkane.uncertainty.draws import Draws
from rollkane.uncertainty.evaluation import Evaluated

GRAVITY = 9.81
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def flat_start(radius, x):
    """A ball at rest on the plane, as a state that others are made of."""
    scene = rk.Scene(rk.Body(1.0, 0.4 * radius**2 * np.eye(3), rk.Sphere(radius)))
    return rk.place(scene, UPRIGHT, (0.0, 0.0, 0.0), (x, 0.0, 0.0))


def rolling(state, rate):
    """The state with an angular velocity about y [rad/s]."""
    turn = rate * jnp.array([0.0, 1.0, 0.0])
    return eqx.tree_at(lambda s: s.angular_velocity, state, turn)


class Inclined:
    """A ball on an inclined plane: how far it rolls [m], by ``rk.ensemble``.

    Inertia ratio k = I / (m r^2), slope a, first speed v: the distance is ``v T + g T^2
    sin a / (2 (1 + k))``.
    """

    slopes, ratios, speeds = (0.2, 0.6), (0.2, 0.6), (1.0, 0.3)
    mass, radius, duration = 0.7, 0.1, 1.5
    names = "slope", "ratio", "speed"

    def __init__(self):
        distributions = Uniform(*self.slopes), Uniform(*self.ratios)
        made = dict(
            zip(self.names, (*distributions, Normal(*self.speeds)), strict=True)
        )
        self.draws = Draws(made)
        self.foot = flat_start(self.radius, 0.0)
        self.made = jax.jit(jax.vmap(self._made))

    def _made(self, u):
        return self.member(self.draws.draw(u))

    def member(self, drawn):
        """Scene and start of one draw."""
        slope, r = drawn["slope"], self.radius
        down = jnp.stack([jnp.sin(slope), 0.0 * slope, -jnp.cos(slope)])
        inertia = drawn["ratio"] * self.mass * r**2 * jnp.eye(3)
        ball = rk.Body(self.mass, inertia, rk.Sphere(r))
        scene = rk.Scene(ball, loads=(rk.Gravity(GRAVITY * down),))
        return scene, rolling(self.foot, drawn["speed"] / r)

    def evaluate(self, u):
        scenes, starts = self.made(jnp.asarray(u))
        runs = rk.ensemble(scenes, starts, (0.0, self.duration), rtol=1e-8)
        end = np.asarray(runs.final_state.contact_on_base)
        return Evaluated({"distance": end[:, 0]}, np.asarray(runs.code))

    def indices(self):
        """First-order and total indices, of slope, ratio and speed."""
        (a, b), (k, m), (_, spread) = self.slopes, self.ratios, self.speeds
        sine = (np.cos(a) - np.cos(b)) / (b - a)
        sine2 = 0.5 - (np.sin(2 * b) - np.sin(2 * a)) / (4 * (b - a))
        share = np.log((1 + m) / (1 + k)) / (m - k)
        share2 = (1 / (1 + k) - 1 / (1 + m)) / (m - k)
        factor = (0.5 * GRAVITY * self.duration**2) ** 2
        slope = factor * share**2 * (sine2 - sine**2)
        ratio = factor * sine**2 * (share2 - share**2)
        both = factor * (sine2 * share2 - sine**2 * share**2) - slope - ratio
        speed = (spread * self.duration) ** 2
        first = np.array([slope, ratio, speed])
        total = np.array([slope + both, ratio + both, speed])
        return first / (first.sum() + both), total / (first.sum() + both)


class Hump:
    """A ball that rolls over a hump: its normal force on the crest over its weight.

    The hump is ``h exp(-x^2 / (2 w^2))``; the crest's radius of curvature at the ball's
    centre is ``w^2 / h + r``, and by the energy the contact is lost where the speed at
    the foot has a square above ``g (w^2 / h + r + 10 h / 7)``. Speed and height are
    random, and the probability a quadrature over the height.
    """

    width, radius, mass = 0.2, 0.05, 0.3
    heights, speeds = (0.045, 0.055), (2.4, 0.114)
    begin = 1.2  # [m]: six widths before the crest, where the hump is 1.5e-8 h high

    def __init__(self):
        self.draws = Draws(
            {"speed": Normal(*self.speeds), "height": Uniform(*self.heights)}
        )
        self.crest = rk.Event(
            lambda scene, t, state: contact_of(scene, t, state).position[0],
            direction=1,
            stop=True,
            name="crest",
        )

        self.foot = flat_start(self.radius, -self.begin)
        self.made = jax.jit(jax.vmap(self._made))
        self.pressed = jax.jit(jax.vmap(self._pressed))

    def height(self, x, y, p):
        return p * jnp.exp(-0.5 * (x / self.width) ** 2) + 0.0 * y

    def _made(self, u):
        """Scene and start of one member."""
        drawn = self.draws.draw(u)
        r = self.radius
        ball = rk.Body(self.mass, 0.4 * self.mass * r**2 * jnp.eye(3), rk.Sphere(r))
        base = rk.Base(rk.Graph(self.height, drawn["height"], ((-2.0, 2.0),) * 2))
        scene = rk.Scene(ball, base)
        return scene, rolling(self.foot, drawn["speed"] / r)

    def evaluate(self, u):
        scenes, starts = self.made(jnp.asarray(u))
        how = {"events": (self.crest,), "rtol": 1e-7, "scene_axes": 0}
        runs = rk.ensemble(scenes, starts, (0.0, 3.0), **how)
        code = np.asarray(runs.code)
        # one that is too slow never comes to the crest, where it would press fully
        slow, crest = code == rk.Code.COMPLETED, code == rk.Code.STOPPED
        share = np.asarray(self.pressed(scenes, runs.final_state))
        values = np.where(slow, 1.0, np.where(crest, share, np.nan))
        return Evaluated({"pressed": values}, np.where(crest, 0, code))

    def _pressed(self, scene, state):
        weight = self.mass * GRAVITY
        return normal_force(scene, jnp.zeros(()), state) / weight

    def critical_speed(self, height):
        """At the foot, above which the contact is lost on the crest [m/s]."""
        square = self.width**2 / height + self.radius + 10.0 / 7.0 * height
        return np.sqrt(GRAVITY * square)

    def probability(self):
        """Of losing the contact: Gauss-Legendre over the height, to 1e-12 of it."""
        low, high = self.heights
        nodes, weights = np.polynomial.legendre.leggauss(40)
        mean, spread = self.speeds
        speeds = self.critical_speed(0.5 * (low + high) + 0.5 * (high - low) * nodes)
        return float(0.5 * weights @ ndtr((mean - speeds) / spread))
