"""The library against independent trajectories and against its own step tolerance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from .. import problems

RTOL = 1e-11


def promised(steps, rtol, scale):
    """What a tolerance promises after many steps.

    Every accepted step errs by at most atol + rtol |y| in the rms norm; the errors of
    these motions (none chaotic over the time shown) add, at worst linearly.
    """
    return int(steps) * rtol * scale


@pytest.fixture(scope="module", params=problems.CASES)
def solved(request):
    scene, start, case = problems.reference_case(request.param)
    result = rk.simulate(scene, start, case["times"], rtol=RTOL, atol=0.01 * RTOL)
    assert bool(result.succeeded)
    return case, result


def check(result, found, reference, reference_error):
    scale = max(1e-3, np.abs(reference).max())
    tolerance = max(10 * reference_error, promised(result.steps, RTOL, scale))
    assert np.abs(np.asarray(found) - np.asarray(reference)).max() <= tolerance


def test_position(solved):
    case, result = solved
    reference = case["reference"]["position"]
    check(result, result.position, reference, case["reference_error"]["position"])


def test_orientation(solved):
    case, result = solved
    error = problems.quaternion_error(
        result.orientation, case["reference"]["quaternion"]
    )
    tolerance = max(
        10 * case["reference_error"]["quaternion"], promised(result.steps, RTOL, 1.0)
    )
    assert error.max() <= tolerance


def test_angular_velocity(solved):
    case, result = solved
    reference = case["reference"]["omega_inertial"]
    check(result, result.angular_velocity, reference, case["reference_error"]["omega"])


def test_contact_points(solved):
    case, result = solved
    error = case["reference_error"]["position"]
    base = case["reference"]["contact_base"]
    check(result, result.contact_on_base, base, error)
    body = case["reference"]["contact_body"]
    # a turn of the body moves the contact point by about its size
    check(result, result.contact_on_body, body, case["reference_error"]["quaternion"])


def test_contact_force(solved):
    case, result = solved
    reference = np.asarray(case["reference"]["contact_force_inertial"])
    omega = np.abs(case["reference"]["omega_inertial"]).max()
    # the force is quadratic in the angular velocity: its error times 2 |omega| m r,
    # with m r <= |F| / g as the load scale
    lever = np.abs(reference).max() / 9.81
    error = 2 * omega * case["reference_error"]["omega"] * lever
    scale = max(np.abs(reference).max(), 2 * omega**2 * lever)
    tolerance = max(10 * error, promised(result.steps, RTOL, scale))
    assert np.abs(np.asarray(result.contact_force) - reference).max() <= tolerance
    normal = np.asarray(case["reference"]["normal_force"])
    assert np.abs(np.asarray(result.normal_force) - normal).max() <= tolerance


def test_energy_is_kept(solved):
    _, result = solved
    energy = np.asarray(result.energy)
    # energy is quadratic in the speeds: twice their relative error
    assert np.ptp(energy) <= 2 * promised(result.steps, RTOL, abs(energy[0]))


def test_rattleback_reverses_when_the_reference_does():
    scene, start, case = problems.reference_case("c09")
    crossings = case["analytic"]["omega3_body_zero_crossings"]
    times = [0.0, *crossings[:3]]
    result = rk.simulate(scene, start, times, rtol=1e-12)
    spin = np.asarray(result.state.angular_velocity)[1:, 2]
    # omega_3 is known to promised(...); 12.5 rad/s is the largest angular velocity
    assert np.abs(spin).max() <= promised(result.steps, 1e-12, 12.5)


def test_ball_leaves_the_sphere_at_ten_seventeenths():
    scene, start, case = problems.reference_case("c24")
    times = np.linspace(0.0, 1.45, 400)
    result = rk.simulate(scene, start, times, rtol=1e-12)
    # cubic Hermite over h = 3.6 ms: h^4/384 N'''' / N' is below 1e-10 s here
    exact = case["analytic"]["exact_time_quadrature"]
    assert abs(float(result.first_pull) - exact) < 1e-9
    assert np.isnan(float(rk.simulate(scene, start, times * 0.5).first_pull))


@pytest.mark.parametrize(
    ("name", "make"), [("P2", problems.disc), ("P3", problems.rattleback)]
)
def test_benchmark_problem(name, make):
    reference = problems.load("bench")[name]
    scene, start = make()
    result = rk.simulate(scene, start, reference["t"], rtol=1e-12, atol=1e-14)
    y = np.asarray(reference["y"])
    centre = np.asarray(problems.mass_centre(result))
    assert np.abs(centre[:, :2] - y[:, 7:]).max() < 1e-9
    assert problems.quaternion_error(result.orientation, y[:, :4]).max() < 1e-9
    omega = np.asarray(result.state.angular_velocity)
    assert np.abs(omega - y[:, 4:7]).max() < 1e-9 * max(1.0, np.abs(y[:, 4:7]).max())
    assert abs(float(result.energy[0]) - reference["E0"]) < 1e-14


def test_error_falls_with_the_tolerance():
    """A run converges to the reference: 100 times tighter gains at least 30 times."""
    scene, start, case = problems.reference_case("c09")
    reference = np.asarray(case["reference"]["position"])
    errors = []
    for rtol in (1e-8, 1e-10, 1e-12):
        result = rk.simulate(scene, start, case["times"], rtol=rtol)
        errors.append(np.abs(np.asarray(result.position) - reference).max())
    assert errors[0] > 30 * errors[1]
    assert errors[1] > 30 * errors[2]


def test_backwards_in_time_returns_to_the_start():
    scene, start = problems.disc()
    there = rk.simulate(scene, start, [0.0, 2.0], rtol=1e-11)
    back = rk.simulate(scene, there.final_state, [2.0, 0.0], rtol=1e-11)
    for a, b in zip(
        jax.tree.leaves(back.final_state), jax.tree.leaves(start), strict=True
    ):
        steps = there.steps + back.steps
        assert float(jnp.max(jnp.abs(a - b), initial=0.0)) <= promised(
            steps, 1e-11, 8.0
        )
