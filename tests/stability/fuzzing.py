"""Random scenes with extreme numbers: whether every run ends, and says how.

A kind of scene is drawn (two surfaces, a base that moves or not, what is carried, a
contact law, loads, changes of the contact), then many scenes of that kind, as one
batch: so every lane has to fail alone, too. One number in sixty, which is one in every
third scene, is replaced by one that no user means: zero, negative, huge, tiny,
infinite, NaN.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk

NUMBERS = 64  # drawn for a scene
ODD = np.array([0.0, -1.0, 1e300, 1e-300, np.inf, -np.inf, np.nan, 1e18, -1e-18])
MAX_STEPS = 3000
KNOWN = {value for name, value in vars(rk.Code).items() if name.isupper()}


class Draw:
    """Hands out the numbers of one scene, in order."""

    def __init__(self, numbers):
        self.numbers, self.used = numbers, 0

    def __call__(self, low, high, shape=()):
        """Uniform between two numbers."""
        size = int(np.prod(shape))
        part = self.numbers[self.used : self.used + size].reshape(shape)
        self.used += size
        return low + (high - low) * part

    def size(self, low, high, shape=()):
        """Positive, spread evenly over the powers of ten."""
        return 10.0 ** self(np.log10(low), np.log10(high), shape)


BODIES: dict[str, Callable] = {
    "sphere": lambda d: rk.Sphere(d.size(1e-2, 10.0)),
    "ellipsoid": lambda d: rk.Ellipsoid(d.size(1e-2, 10.0, (3,))),
    "torus": lambda d: rk.Torus(d.size(0.5, 10.0), d.size(1e-2, 0.4)),
    "disc": lambda d: rk.DiscEdge(d.size(1e-2, 10.0)),
}
BASES: dict[str, Callable] = {
    "plane": lambda d: rk.Plane(),
    "hill": lambda d: rk.Sphere(d.size(1.0, 1e3)),
    "bowl": lambda d: rk.Ellipsoid(d.size(1.0, 1e3, (3,)), inside=True),
    "graph": lambda d: rk.Graph(
        lambda x, y, p: p[0] * x**2 + p[1] * jnp.sin(x + p[2] * y), d(-1.0, 1.0, (3,))
    ),
    "cylinder": lambda d: rk.Cylinder(d.size(1.0, 1e3)),
}
MOTIONS: dict[str, Callable] = {
    "rest": lambda d: None,
    "rest again": lambda d: None,
    "turntable": lambda d: rk.Spin(d(-10.0, 10.0)),
    "shaken": lambda d: rk.BaseMotion(
        lambda t, p: p[0] * jnp.sin(p[1] * t) * p[2:5],
        parameters=d(0.0, 3.0, (5,)),
    ),
}
CARRIED: dict[str, Callable] = {
    "nothing": lambda d: (),
    "nothing else": lambda d: (),
    "a mass": lambda d: rk.PointMasses(
        d.size(1e-6, 1e2, (1,)),
        lambda a, p: jnp.stack([p[:3] + a[0] * p[3:6]]),
        lambda t, a, a_dot, p: -p[6] * a - p[7] * a_dot,
        parameters=d(-1.0, 1.0, (8,)),
        coordinates=1,
    ),
}
LAWS: dict[str, Callable] = {
    "rolls": lambda d: rk.Rolling(),
    "rolls freely": lambda d: rk.Rolling(),
    "rubber": lambda d: rk.RubberRolling(),
    "oil": lambda d: rk.Slipping(rk.ViscousFriction(d.size(1e-3, 1e3))),
    "dry": lambda d: rk.Slipping(
        rk.CoulombFriction(d(0.0, 2.0), d.size(1e-3, 1.0)),
    ),
}
LOADS: dict[str, Callable] = {
    "gravity": lambda d: (rk.Gravity(d(-10.0, 10.0, (3,))),),
    "down": lambda d: (rk.Gravity(),),
    "drag": lambda d: (rk.Gravity(), rk.Drag(d.size(1e-3, 10.0), d.size(1e-3, 10.0))),
    "resistance": lambda d: (rk.Gravity(), rk.RollingResistance(d.size(1e-5, 1.0))),
    "nothing": lambda d: (),
}
CHANGES: dict[str, Callable] = {
    "none": lambda d: None,
    "none at all": lambda d: None,
    "changes": lambda d: rk.Modes(friction=d(0.0, 1.0), restitution=d(0.0, 1.0)),
}
PARTS = BODIES, BASES, MOTIONS, CARRIED, LAWS, LOADS, CHANGES


class Outcome(NamedTuple):
    """What is judged of a batch, a row for each scene."""

    code: np.ndarray
    time: np.ndarray
    final_time: np.ndarray
    states: np.ndarray
    final: np.ndarray


def drawn_kind(seed: int) -> tuple[str, ...]:
    """Names of the parts of a kind."""
    draw = np.random.default_rng([seed, 1])
    return tuple(str(draw.choice(list(part))) for part in PARTS)


def drawn_numbers(seed: int, count: int) -> np.ndarray:
    """For many scenes of it."""
    draw = np.random.default_rng([seed, 2])
    numbers = draw.random((count, NUMBERS))
    odd = draw.random(numbers.shape) < 1.0 / 60.0
    return np.where(odd, draw.choice(ODD, numbers.shape), numbers)


def scene_of(kind: tuple[str, ...], d: Draw):
    """A scene, and its modes."""
    makes = [part[name] for part, name in zip(PARTS, kind, strict=True)]
    body, base, motion, carried, law, loads, changes = makes
    surface = body(d)
    # a box of its own size, and what stands out of it
    box = d.size(1e-2, 10.0, (3,))
    mass = d.size(1e-3, 1e3)
    square = box**2
    inertia = mass / 3.0 * jnp.diag(jnp.sum(square) - square)
    made = rk.Body(mass, inertia, surface, d(-0.1, 0.1, (3,)))
    parts = rk.Base(base(d), motion(d)), carried(d), loads(d), law(d)
    return rk.Scene(made, *parts[:3], contact=parts[3]), changes(d)


def run(kind: tuple[str, ...], numbers: np.ndarray) -> Outcome:
    """All scenes of a kind, in one batch."""

    def one(numbers):
        d = Draw(numbers)
        scene, modes = scene_of(kind, d)
        q = d(-1.0, 1.0, (4,))
        q = q / jnp.sqrt(jnp.sum(q * q))
        w = d(-1.0, 1.0, (3,)) * d.size(1e-3, 1e3)
        low, high = np.array(scene.base.surface.chart_domain).T
        point = scene.base.surface.chart(d(0.05, 0.95, (2,)) * (high - low) + low)
        count = scene.coordinate_count
        alpha = d(-1.0, 1.0, (count,)), d(-1.0, 1.0, (count,))
        start = rk.place(scene, q, w, point, *alpha)
        times = jnp.linspace(0.0, 1.0, 5) * d.size(1e-2, 2.0)
        how = {"rtol": 1e-6, "max_steps": MAX_STEPS}
        how |= {} if modes is None else {"modes": modes}
        run = rk.simulate(scene, start, times, **how)
        flat = lambda state: jnp.concatenate(
            [
                jnp.ravel(x)
                for x in jax.tree.leaves(state)
                if jnp.issubdtype(x, jnp.floating)
            ]
        )
        states = jax.vmap(flat)(run.state)
        return Outcome(
            run.code, run.time, run.final_time, states, flat(run.final_state)
        )

    return Outcome(*map(np.asarray, jax.jit(jax.vmap(one))(jnp.asarray(numbers))))


def unexplained(found: Outcome) -> list[tuple[int, str]]:
    """Scenes that did not end as they should, and what is wrong."""
    wrong = []
    for i, code in enumerate(found.code):
        finite = np.isfinite(found.states[i]).all(axis=-1)
        reached = found.time[i] <= found.final_time[i]
        if int(code) not in KNOWN:
            wrong.append((i, f"code {code} is not known"))
        elif code == rk.Code.COMPLETED and not finite.all():
            wrong.append((i, "completed, with NaN"))
        elif code not in (rk.Code.COMPLETED, rk.Code.BAD_START, rk.Code.BAD_SCENE):
            if not np.isfinite(found.final_time[i]):
                wrong.append((i, f"code {code}, and no time that was reached"))
            elif not finite[reached].all():
                wrong.append((i, f"code {code}, and NaN before the time it reached"))
            elif not np.isfinite(found.final[i]).all():
                wrong.append((i, f"code {code}, and no state that was reached"))
    return wrong
