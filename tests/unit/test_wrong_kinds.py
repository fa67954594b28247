"""What takes a Scene says so of a KaneSystem, and the other way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane

SPEED = lambda t, q, u: [u[0] * jnp.cos(q[0]), u[0] * jnp.sin(q[0]), 0.0]
PENDULUM = kane.KaneSystem(
    1,
    1,
    lambda t, q, u: u,
    [kane.Particle(1.0, SPEED)],
    [kane.Load(SPEED, lambda t, q, u: [0.0, -9.81, 0.0])],
)
STATE = kane.KaneState(jnp.array([0.5]), jnp.array([0.0]))
BALL = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)))
TIMES = np.linspace(0.0, 1.0, 5)
RECORD = rk.Record(TIMES, {"gyro": rk.Gyro(np.zeros((5, 3)), sigma=0.1)})
START = rk.place(BALL, (1, 0, 0, 0), (0, 0, 0), (0, 0, 0))
SPIN = lambda scene, t, state: state.angular_velocity[2]


@pytest.mark.parametrize(
    "call",
    [
        lambda: rk.periodic_motion(PENDULUM, STATE, 1.7),
        lambda: rk.lyapunov_exponents(PENDULUM, STATE, 10.0),
        lambda: rk.normal_modes(PENDULUM, STATE),
        lambda: rk.normal_mode_motion(PENDULUM, STATE, 0.1),
        lambda: rk.symmetries(PENDULUM),
        lambda: rk.keeping_energy(PENDULUM, STATE),
        lambda: rk.equations_of_motion(PENDULUM, 0.0, STATE),
        lambda: rk.negative_log_likelihood(PENDULUM, STATE, RECORD),
        lambda: rk.sensitivity(PENDULUM, STATE, TIMES, "parts", {"spin": SPIN}),
        lambda: rk.with_feedback(PENDULUM, lambda t, state: jnp.zeros(3)),
    ],
)
def test_a_kane_system_is_no_scene(call):
    with pytest.raises(
        rk.FieldError, match="must be a Scene, not a KaneSystem"
    ) as told:
        call()
    assert "KaneSystem(" not in str(told.value)  # its kind is enough


def test_a_scene_is_no_kane_system():
    with pytest.raises(rk.FieldError, match="integrate it by rollkane"):
        kane.simulate(BALL, START, TIMES)


def test_observables_have_names():
    with pytest.raises(rk.FieldError, match="names no functions"):
        rk.sensitivity(BALL, START, TIMES, "body.mass", SPIN)


IMAGINARY = lambda x: jax.lax.complex(0.0 * x, x)
COMPLEX = {
    "Graph.f": lambda: rk.Graph(lambda x, y: IMAGINARY(x * x + y * y)),
    "BaseMotion.position": lambda: rk.BaseMotion(lambda t: IMAGINARY(t * jnp.ones(3))),
    "KaneSystem.kinematics": lambda: kane.KaneSystem(
        1, 1, lambda t, q, u: IMAGINARY(u), [kane.Particle(1.0, SPEED)]
    ),
    "KaneSystem.loads": lambda: kane.KaneSystem(
        1,
        1,
        lambda t, q, u: u,
        [kane.Particle(1.0, SPEED)],
        [kane.Load(SPEED, lambda t, q, u: [0.0, IMAGINARY(q[0]), 0.0])],
    ),
}


@pytest.mark.parametrize("field", COMPLEX)
def test_functions_of_complex_numbers_are_refused(field):
    """Their imaginary parts were dropped, with a warning of NumPy's at most."""
    with pytest.raises(rk.FieldError, match="returns complex numbers") as told:
        COMPLEX[field]()
    assert told.value.field.split("[")[0] == field


def test_a_second_function_is_no_parameter():
    with pytest.raises(rk.FieldError, match="let one function return all") as told:
        rk.Revolution(lambda s: 0.1 * jnp.sin(s), lambda s: -0.1 * jnp.cos(s))
    assert told.value.field == "Revolution.parameters"
