"""A number that a constructor takes is kept once: varied by its path, all follow it.

Fits, sweeps, sensitivities and `eqx.tree_at` put other numbers into a value that is
made. A copy of one in another field, which its constructor derived from it, would stay
what it was, and the model would be none that a user could make.
"""

import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

INERTIA = np.diag([1.0, 1.2, 1.5])
TIME = 0.02 * np.arange(8)
SHAKEN = np.stack([np.sin(TIME), TIME, 0.0 * TIME], axis=1)
SLIDES = lambda a: jnp.stack([a[0], 0.0, 0.0])[None]
MADE = [
    (rk.Sphere, {"radius": 0.1}),
    (rk.Sphere, {"radius": 0.1, "center": (0.0, 0.1, 0.2)}),
    (rk.Ellipsoid, {"semi_axes": (0.1, 0.2, 0.3)}),
    (rk.Torus, {"major_radius": 0.3, "minor_radius": 0.1}),
    (rk.Ring, {"radius": 0.2}),
    (rk.DiscEdge, {"radius": 0.2}),
    (rk.Cylinder, {"radius": 0.2}),
    (rk.Cone, {"slope": 0.5}),
    (rk.Implicit, {"f": lambda x: jnp.sum(x * x) - 1.0, "center": (0.0, 0.1, 0.0)}),
    (rk.Modes, {"friction": 0.2}),
    (rk.Modes, {"friction": 0.2, "static_friction": 0.3, "restitution": 0.5}),
    (rk.CoulombFriction, {"coefficient": 0.2}),
    (rk.StribeckFriction, {"static": 0.3, "kinetic": 0.2, "speed": 0.1}),
    (rk.ViscousFriction, {"coefficient": 0.2}),
    (rk.RollingResistance, {"viscous": 0.1, "dry": 0.1}),
    (rk.SpinningResistance, {"viscous": 0.1, "dry": 0.1}),
    (rk.Drag, {"linear": 0.1, "quadratic": 0.2, "angular": 0.3}),
    (rk.Gravity, {}),
    (rk.Force, {"force": (1.0, 2.0, 3.0), "point": (0.1, 0.0, 0.0)}),
    (rk.Torque, {"torque": (1.0, 2.0, 3.0)}),
    (rk.Spin, {"rate": 2.0}),
    (rk.RecordedMotion, {"time": TIME, "acceleration": SHAKEN}),
    (
        rk.Body,
        {
            "mass": 1.0,
            "inertia": INERTIA,
            "surface": rk.Sphere(0.1),
            "center_of_mass": (0.01, 0.0, 0.02),
        },
    ),
    (rk.PointMasses, {"mass": 0.1, "position": SLIDES, "coordinates": 1}),
    (rk.Gyro, {"values": SHAKEN, "sigma": 0.1}),
    (rk.Position, {"values": SHAKEN, "sigma": 0.1, "at": (0.1, 0.0, 0.0)}),
]


@pytest.mark.parametrize(
    ("kind", "given"), MADE, ids=lambda x: getattr(x, "__name__", "")
)
def test_a_number_put_in_is_a_number_given(kind, given):
    made = kind(**given)
    taken = inspect.signature(kind.__init__).parameters
    numbers = {k: x for k, x in vars(made).items() if k in taken}
    numbers = {k: x for k, x in numbers.items() if eqx.is_inexact_array(x)}
    assert numbers
    for name, x in numbers.items():
        put_in = eqx.tree_at(lambda v, k=name: getattr(v, k), made, 1.01 * x)
        anew = kind(**(given | {name: 1.01 * x}))
        for at, a in jax.tree_util.tree_leaves_with_path(anew):
            b = dict(jax.tree_util.tree_leaves_with_path(put_in))[at]
            np.testing.assert_array_equal(a, b, f"{name}: {at}")
