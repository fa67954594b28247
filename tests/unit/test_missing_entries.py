"""Functions that ask their parameters, or a draw, for an entry that is not there."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.validation.checks import FieldError

MASS = {"mass": 1.0}


def along(t, q, u):
    return [u[0], 0.0, 0.0]


def system(kinematics=lambda t, q, u: u, parts=(), loads=(), **given):
    given = {"parameters": MASS} | given
    return kane.KaneSystem(1, 1, kinematics, parts, loads, **given)


def upwards(t, x, p):
    return jnp.array([0.0, 0.0, p["b"]])


SQUARE = (-1.0, 1.0), (-1.0, 1.0)
ASKING = {
    "KaneSystem.kinematics": lambda: system(lambda t, q, u, p: [p["b"] * u[0]]),
    "KaneSystem.parts[0].mass": lambda: system(
        parts=[kane.Particle(lambda p: p["b"], along)]
    ),
    "KaneSystem.parts[0].velocity": lambda: system(
        parts=[kane.Particle(1.0, lambda t, q, u, p: [p["b"] * u[0], 0.0, 0.0])]
    ),
    "KaneSystem.loads[0].load": lambda: system(
        loads=[kane.Load(along, lambda t, q, u, p: [p["b"], 0.0, 0.0])]
    ),
    "KaneSystem.constraints": lambda: system(
        constraints=lambda t, q, u, p: [p["b"] * u[0]], dependent=None
    ),
    "KaneSystem.shared": lambda: system(shared=lambda t, q, u, p: p["b"]),
    "Graph.f": lambda: rk.Graph(lambda x, y, p: p["b"] * x, MASS),
    "Parametric.position": lambda: rk.Parametric(
        lambda x, y, p: jnp.array([x, y, p["b"]]), domain=SQUARE, parameters=MASS
    ),
    "Implicit.f": lambda: rk.Implicit(lambda x, y, z, p: p["b"] * z, parameters=MASS),
    "Force.force": lambda: rk.Force(upwards, parameters=MASS),
    "BaseMotion.position": lambda: rk.BaseMotion(
        lambda t, p: jnp.array([0.0, 0.0, p["b"] * t]), parameters=MASS
    ),
    "PointMasses.position": lambda: rk.PointMasses(
        0.1, lambda a, p: jnp.array([0.0, 0.0, p["b"] * a[0]]), 1, parameters=MASS
    ),
}


@pytest.mark.parametrize("field", ASKING)
def test_an_entry_that_parameters_do_not_have(field):
    with pytest.raises(FieldError) as told:
        ASKING[field]()
    assert told.value.field == field
    problem = "asks for the entry 'b' of `parameters`, where there is 'mass' alone"
    assert told.value.problem == problem
    assert told.value.remedy == (
        "give `parameters` that entry, or ask for one that is there"
    )


def test_an_entry_of_what_is_shared():
    with pytest.raises(FieldError, match="'b' of `shared`, where there are 'x', 'y'"):
        system(
            lambda t, q, u, now: [now["b"] * u[0]],
            shared=lambda t, q, u, p: {"x": p["mass"], "y": q[0]},
        )


def test_entries_of_no_parameters():
    with pytest.raises(FieldError, match=r"of `parameters`, and there is none"):
        system(lambda t, q, u, p: [p["b"] * u[0]], parameters=None)


def test_other_mistakes_of_a_function_are_told_as_before():
    """A key of its own table, where parameters are no table; no value."""
    own = {"a": 1.0}
    for kinematics in (lambda t, q, u, p: [own["b"]], lambda t, q, u, p: p.b):
        with pytest.raises(FieldError, match="kinematics: cannot be traced by JAX"):
            system(kinematics, parameters=jnp.ones(2))


BALL = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))


def test_a_draw_that_is_not_drawn():
    scene = rk.Scene(BALL)

    def make(draw):
        still = (0.0, 0.0, 0.0)
        return scene, rk.place(
            scene, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, draw["spn"]), still
        )

    study = rk.Study(
        make,
        {"spin": rk.Normal(0.0, 1.0)},
        (0.0, 0.1),
        observe={"end": lambda scene, t, state: state.angular_velocity[2]},
    )
    with pytest.raises(FieldError) as told:
        rk.monte_carlo(study, 4)
    assert told.value.field == "Study.make"
    assert "the entry 'spn' of `distributions`, where there is 'spin' alone" in str(
        told.value
    )
