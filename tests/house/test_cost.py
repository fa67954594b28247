"""Deterministic costs: equations of a right-hand side, and number of compilations."""

import json
import logging
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics import contact_laws, mass_matrix
from rollkane.dynamics.bodies import inertia_about
from rollkane.geometry.rotations import rotation_matrix
from rollkane.geometry.small_linear import (
    components,
    cross,
    matvec_transposed,
    solve_spd,
)
from rollkane.kinematics import contact
from rollkane.kinematics.base_motion import BaseKinematics
from rollkane.kinematics.contact import rolling_contact
from rollkane.paper import quasi_energy

from .. import problems
from ..quick import slow_but

BASELINE = Path(__file__).parent / "cost_baseline.json"


def scenes():
    disc, stone = problems.disc(), problems.rattleback()
    bowl = rk.Base(rk.Graph(lambda x, y: 0.4 * x**2 + 0.2 * y**2))
    body = rk.Body(1.0, 0.01 * np.eye(3), rk.Ellipsoid((0.2, 0.15, 0.1)))
    in_bowl = rk.Scene(body, bowl)
    level = (1.0, 0.0, 0.0, 0.0)
    carried = rk.Implicit(lambda p: jnp.sum(p * p) - 0.04)
    blob = rk.Scene(rk.Body(1.0, 0.01 * np.eye(3), carried))
    on_ball = rk.Scene(body, rk.Base(rk.Sphere(1.0)))
    no_load = rk.Scene(body, loads=())
    spin, origin = (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    return {
        "rolling-disc": disc,
        "rattleback": stone,
        "ellipsoid-in-bowl": (in_bowl, rk.place(in_bowl, level, spin, origin)),
        "ellipsoid-on-sphere": (
            on_ball,
            rk.place(on_ball, level, spin, (0.0, 0.0, 1.0)),
        ),
        "implicit-ball": (blob, rk.place(blob, level, spin, origin)),
        "no-load": (no_load, rk.place(no_load, level, spin, origin)),
        **effects(),
        **laws(),
    }


def slide(a, p):
    return p["rail"] * a[0]


def effects():
    """One body, with nothing and with one effect more each."""
    body = rk.Body(1.0, 0.01 * np.eye(3), rk.Ellipsoid((0.2, 0.15, 0.1)))
    shake = lambda t: 0.1 * jnp.stack([jnp.sin(t), jnp.cos(t), jnp.sin(2.0 * t)])
    turn = lambda t: rotation_matrix(jnp.stack([jnp.cos(t), 0.0 * t, t, jnp.sin(t)]))
    bases = {
        "translation": rk.BaseMotion(position=shake),
        "rotation": rk.BaseMotion(rotation=turn),
        "spin": rk.Spin(0.7),
    }
    made = {"at-rest": rk.Scene(body)}
    made |= {
        name: rk.Scene(body, rk.Base(rk.Plane(), motion=motion))
        for name, motion in bases.items()
    }
    slider = rk.PointMasses((0.1,), slide, parameters={"rail": np.eye(3)[:1]})
    thin, along = 1e-4 * np.eye(3), {"rail": np.eye(3)[0]}
    level = lambda a, p: jnp.eye(3) + 0.0 * a[0] * p["rail"][0]
    arm = rk.SupportedBody(0.1, thin, slide, level, parameters=along)
    made["slider"] = rk.Scene(body, supported=(slider,))
    made["supported-body"] = rk.Scene(body, supported=(arm,))
    upright, spin, origin = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    starts = {}
    for name, scene in made.items():
        rest = np.zeros(scene.coordinate_count)
        starts[name] = (scene, rk.place(scene, upright, spin, origin, rest, rest))
    return starts


def laws():
    """The same body under each contact law and each load."""
    body = rk.Body(1.0, 0.01 * np.eye(3), rk.Ellipsoid((0.2, 0.15, 0.1)))
    contacts = {
        "rubber": rk.RubberRolling(),
        "slipping-viscous": rk.Slipping(rk.ViscousFriction(0.1)),
        "slipping-coulomb": rk.Slipping(rk.CoulombFriction(0.1)),
        "slipping-stribeck": rk.Slipping(rk.StribeckFriction(0.2, 0.1, 0.1)),
    }
    loads = {
        "drag": rk.Drag(0.1, 0.1, 0.1),
        "force": rk.Force((1.0, 0.0, 0.0)),
        "torque": rk.Torque((1.0, 0.0, 0.0)),
        "potential": rk.Potential(lambda p: jnp.sum(p * p)),
        "rolling-resistance": rk.RollingResistance(viscous=0.1),
        "rolling-resistance-dry": rk.RollingResistance(dry=0.1),
        "spinning-resistance": rk.SpinningResistance(viscous=0.1),
    }
    made = {name: rk.Scene(body, contact=law) for name, law in contacts.items()}
    made |= {
        name: rk.Scene(body, loads=(rk.Gravity(), load)) for name, load in loads.items()
    }
    where = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    return {name: (scene, rk.place(scene, *where)) for name, scene in made.items()}


def traced(derivative, scene, start):
    """The program of a right-hand side."""
    return jax.make_jaxpr(derivative)(scene, jnp.zeros(()), start)


def equations(scene, start):
    return counted(traced(rk.rolling_derivative, scene, start))


def counted(jaxpr):
    """Equations of a program, in place of each call those of what it calls."""
    inner = (e.params.get("jaxpr") for e in jaxpr.eqns)
    return sum(1 if program is None else counted(program) for program in inner)


@pytest.fixture(scope="module")
def counts():
    return {name: equations(*scene) for name, scene in scenes().items()}


def test_equations_do_not_grow(counts):
    """Fewer is welcome (write the new baseline); more needs a reason.

    jax counts its own wrappers differently from release to release, so the figures are
    kept by release.
    """
    baseline = json.loads(BASELINE.read_text())
    release = ".".join(jax.__version__.split(".")[:2])
    if release not in baseline:
        newest = baseline[max(baseline)]
        for name, count in counts.items():
            assert count < 1.2 * newest[name], name
    else:
        assert counts == baseline[release]


def test_gravity_is_not_in_a_scene_without(counts):
    body = rk.Body(1.0, 0.01 * np.eye(3), rk.Ellipsoid((0.2, 0.15, 0.1)))
    heavy = rk.Scene(body)
    start = rk.place(heavy, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    assert counts["no-load"] < equations(heavy, start)


def symmetric(rows, w):
    """A symmetric matrix, given by its lower triangle, times a vector."""
    x = components(w)
    full = [[rows[max(i, j)][min(i, j)] * x[j] for j in range(3)] for i in range(3)]
    return jnp.stack([a + b + c for a, b, c in full])


def core(scene, t, state):
    """A body on a plane at rest, with its weight: nothing else is written."""
    del t
    body, base = scene.body, scene.base.surface
    w = state.angular_velocity
    contact = rolling_contact(
        body.surface,
        base,
        state.orientation,
        w,
        state.contact_on_base,
        state.contact_on_body,
    )
    c = body.center_of_mass - contact.body_point
    rows = inertia_about(body.mass, c, body.inertia)
    proper = cross(contact.velocity, w)
    for gravity in scene.loads:
        proper = proper - matvec_transposed(contact.rotation, gravity.acceleration)
    rhs = cross(body.mass * proper, c) - cross(w, symmetric(rows, w))
    turn = jnp.stack(solve_spd(rows, components(rhs)))
    return state.rates(contact, turn, jnp.zeros(0, turn.dtype))


@pytest.mark.parametrize(
    "name",
    slow_but(
        ["rolling-disc", "implicit-ball"],
        ["rolling-disc", "rattleback", "implicit-ball", "no-load"],
    ),
)
def test_a_scene_without_effects_is_the_core_alone(name):
    """Equation by equation: what a scene does not name leaves nothing behind."""
    scene, start = scenes()[name]
    bare = traced(core, scene, start)
    assert str(traced(rk.rolling_derivative, scene, start)) == str(bare)


@pytest.mark.parametrize("equations", [None, "2.5", "2.3", "2.9"])
def test_no_formulation_asks_for_an_effect_that_is_not_there(equations, monkeypatch):
    """Every door to a moving base and to supported parts is locked."""

    def locked(*args, **kwargs):
        raise AssertionError("an effect that the scene does not name was computed")

    scene, start = problems.rattleback()
    doors = "to_fixed", "to_base", "placed", "on_base", "velocity_at"
    for name in (*doors, "acceleration_at"):
        assert callable(getattr(BaseKinematics, name))
        monkeypatch.setattr(BaseKinematics, name, locked)
    for module in (mass_matrix, quasi_energy):
        monkeypatch.setattr(module, "total", locked)
    for name in ("momentum_rate", "_solve", "_slipping", "_against_spin"):
        assert callable(getattr(contact_laws, name))
        monkeypatch.setattr(contact_laws, name, locked)
    assert callable(contact._normal_rate)
    monkeypatch.setattr(contact, "_normal_rate", locked)
    if equations is None:
        derivative = rk.rolling_derivative
    else:
        derivative = lambda *a: rk.euler_lagrange_derivative(*a, equations=equations)
    assert traced(derivative, scene, start).eqns


def test_an_effect_costs_only_itself(counts):
    """A base that turns steadily is cheaper than one that turns as it likes; a base
    that only translates adds no rotation; all are dearer than none. What does not ask
    for the normal force does not pay for it."""
    still = counts["at-rest"]
    assert still < counts["translation"] < counts["rotation"]
    assert still < counts["spin"] < counts["rotation"]
    assert still < counts["slider"] < counts["supported-body"]
    assert all(still < counts[name] for name in laws())
    assert counts["slipping-viscous"] < counts["slipping-coulomb"]
    assert counts["rolling-resistance"] < counts["rolling-resistance-dry"]


def test_a_second_call_compiles_nothing(caplog):
    """Other numbers, same structure: scene, start, tolerance and times may change."""
    first, second = problems.disc(), problems.disc(5.0, 0.31)
    jax.clear_caches()  # whatever other tests of this process have compiled
    with jax.log_compiles(True), caplog.at_level(logging.WARNING):
        result = rk.simulate(*first, (0.0, 0.1, 0.2), rtol=1e-8)
        jax.block_until_ready((result.position, result.energy))
        assert any("Compiling" in message for message in caplog.messages)
        caplog.clear()
        times, tolerances = (0.0, 0.15, 0.3), {"rtol": 1e-9, "atol": 1e-12}
        result = rk.simulate(*second, times, **tolerances)
        jax.block_until_ready((result.position, result.energy))
    assert not [message for message in caplog.messages if "Compiling" in message]
