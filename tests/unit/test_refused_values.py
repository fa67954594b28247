"""Values that gave wrong results in silence: refused, or warned of."""

import warnings

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.observables import base_rotation
from rollkane.kane import KaneState, KaneSystem, Particle, simulate

from .. import problems

LEVEL = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
INERTIA = 0.004 * np.eye(3)
BALL = rk.Body(1.0, INERTIA, rk.Sphere(0.1))

MODES = {
    "restitution 1.5": ({"restitution": 1.5}, "restitution", "must not be above 1"),
    "restitution -0.1": ({"restitution": -0.1}, "restitution", "negative"),
    "restitution NaN": ({"restitution": np.nan}, "restitution", "finite"),
    "friction infinite": ({"friction": np.inf}, "friction", "finite"),
    "sticking less than sliding": (
        {"friction": 0.3, "static_friction": 0.2},
        "static_friction",
        "below that of sliding",
    ),
    "sticking alone": ({"static_friction": 0.2}, "static_friction", "of no use"),
    "no switches": ({"switches": 0}, "switches", "at least 1"),
    "half a switch": ({"switches": 2.5}, "switches", "whole number"),
    "lifts by a number": ({"lifts": 1}, "lifts", "True or False"),
}


@pytest.mark.parametrize("name", MODES)
def test_modes_that_no_contact_has(name):
    values, field, says = MODES[name]
    with pytest.raises(rk.FieldError, match=says) as caught:
        rk.Modes(**values)
    assert caught.value.field == f"Modes.{field}"


def test_the_limits_themselves_are_allowed():
    modes = rk.Modes(friction=0.0, static_friction=0.0, restitution=1.0, switches=1)
    assert float(modes.restitution) == 1.0
    assert float(rk.Modes(restitution=0.0).restitution) == 0.0


OPTIONS = {
    "rtol": ({"rtol": 10.0}, "leaves no digit"),
    "rtol at which nothing is known": ({"rtol": 0.5}, "leaves no digit"),
    "max_steps": ({"max_steps": 0}, "at least 1"),
    "max_steps by half": ({"max_steps": 10.5}, "whole number"),
    "dt0": ({"dt0": -0.1}, "positive"),
    "dt0 NaN": ({"dt0": np.nan}, "positive"),
    "dt0 infinite": ({"dt0": np.inf}, "positive"),
    "second_contact": ({"second_contact": "yes"}, "True or False"),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_options_that_make_no_sense(name):
    values, says = OPTIONS[name]
    scene, start = problems.disc(6.0)
    with pytest.raises(rk.FieldError, match=says) as caught:
        rk.simulate(scene, start, [0.0, 0.1], **values)
    assert caught.value.field == f"simulate.{next(iter(values))}"


def test_the_loosest_tolerance_is_allowed():
    scene, start = problems.disc(6.0)
    assert rk.simulate(scene, start, [0.0, 0.1], rtol=0.1).succeeded


@pytest.mark.parametrize("surface", [rk.Sphere(0.02), rk.Ellipsoid((0.02, 0.01, 0.01))])
def test_a_mass_centre_outside_of_the_stone_is_told(surface):
    with pytest.warns(UserWarning, match="Body.center_of_mass .* lies outside"):
        rk.Body(1.0, INERTIA, surface, (0.5, 0.0, 0.0))


def test_a_mass_centre_beside_a_foot_is_not():
    """Of a part of a body nobody can tell where the rest is."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rk.Body(1.0, INERTIA, rk.Sphere(0.02), (0.01, 0.0, 0.0))
        rk.Body(1.0, INERTIA, rk.Sphere(0.02, (0.0, 0.0, -0.5)))
        rk.Body(1.0, INERTIA, rk.Sphere(0.02, inside=True), (0.5, 0.0, 0.0))
        rk.Body(1.0, INERTIA, rk.DiscEdge(0.02), (0.0, 0.0, 0.05))
        jax.jit(lambda c: rk.Body(1.0, INERTIA, rk.Sphere(0.02), c))(jnp.ones(3))


def swapped(u, v):
    """A hill with its two parameters the wrong way round: material above."""
    return jnp.stack([v, u, -0.1 * (u * u + v * v)])


WRONG_WAY = {
    "swapped parameters": (
        lambda: rk.Parametric(swapped, domain=((-1.0, 1.0), (-1.0, 1.0))),
        rk.Base,
        (0.0, 0.0, 0.0),
    ),
    "the sign of an implicit": (
        lambda: rk.Implicit(lambda x, y, z: 4.0 - x * x - y * y - z * z, size=3.0),
        rk.Base,
        (0.0, 0.0, 2.0),
    ),
    "a bowl without inside": (
        lambda: rk.Revolution(lambda s: (s, s * s), domain=(0.0, 1.0)),
        rk.Base,
        (0.0, 0.0, 0.0),
    ),
}


@pytest.mark.parametrize("name", WRONG_WAY)
def test_normals_the_wrong_way_are_told(name):
    make, base, at = WRONG_WAY[name]
    scene = rk.Scene(BALL, base(make()))
    with pytest.warns(UserWarning, match="pull the body off its base"):
        start = rk.place(scene, LEVEL, STILL, at, allow_overlap=True)
    assert rk.simulate(scene, start, [0.0, 0.01]).normal_force[0] < 0.0


def test_what_pulls_by_its_speed_or_is_pressed_on_is_not_told():
    """Fast over a hill: the loads press. At the top of a loop: the speed does."""
    hill = rk.Scene(BALL, rk.Base(rk.Sphere(1.0)))
    loop = rk.Scene(BALL, rk.Base(rk.Cylinder(1.0, inside=True)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fast = rk.place(hill, LEVEL, (0.0, 60.0, 0.0), (0.0, 0.0, 1.0))
        assert rk.simulate(hill, fast, [0.0, 0.01]).normal_force[0] < 0.0
        loads = rk.Gravity((0.0, -9.81, 0.0))
        loop = rk.Scene(BALL, loop.base, loads=(loads,))
        rk.place(loop, LEVEL, (0.0, 0.0, 90.0), (0.0, 1.0, 0.0))


# -- energy that is put back -----------------------------------------------------------


def test_the_energy_that_is_kept_is_that_of_the_run():
    """Was: that of the start for which the solver was made, put into any other."""
    scene, start = problems.disc(6.0)
    other = problems.disc(3.0)[1]
    keeping = rk.keeping_energy(scene, start, dfx.Tsit5())
    times = np.linspace(0.0, 0.5, 6)
    run = rk.simulate(scene, other, times, solver=keeping, rtol=1e-5)
    own = float(rk.simulate(scene, other, [0.0, 0.01]).energy[0])
    assert abs(own - float(rk.simulate(scene, start, [0.0, 0.01]).energy[0])) > 1.0
    np.testing.assert_allclose(run.energy, own, rtol=1e-13)


def test_a_scene_that_loses_energy_is_refused():
    """Was: a damping was undone."""
    scene, start = problems.disc(6.0)
    keeping = rk.keeping_energy(scene, start)
    damped = rk.Scene(scene.body, scene.base, loads=(rk.Gravity(), rk.Drag(linear=0.1)))
    turning = rk.Scene(scene.body, rk.Base(rk.Plane(), rk.Spin(1.0)))
    for other in (damped, turning):
        with pytest.raises(rk.FieldError, match="does not keep its energy"):
            rk.simulate(other, start, [0.0, 0.1], solver=keeping)
        with pytest.raises(rk.FieldError, match="does not keep its energy"):
            rk.keeping_energy(other, start)


@pytest.mark.slow
def test_derivatives_of_a_run_that_keeps_its_energy():
    """By the start, whose energy moves with it; against a run without keeping."""
    scene, start = problems.disc(6.0)
    keeping = rk.keeping_energy(scene, start)

    def end(w, solver):
        import equinox as eqx

        begun = eqx.tree_at(lambda s: s.angular_velocity, start, w)
        run = rk.simulate(scene, begun, [0.0, 0.3], solver=solver, rtol=1e-11)
        return run.final_state.contact_on_base

    w = start.angular_velocity
    found = jax.jacfwd(lambda w: end(w, keeping))(w)
    wanted = jax.jacfwd(lambda w: end(w, None))(w)
    # two runs at rtol 1e-11
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-8)


def test_no_energy_of_a_kane_system():
    from rollkane import kane

    part = kane.Particle(1.0, lambda t, q, u: [u[0], 0.0, 0.0])
    system = kane.KaneSystem(1, 1, lambda t, q, u: u, [part])
    start = kane.KaneState(jnp.zeros(1), jnp.ones(1))
    keeping = rk.keeping_energy(*problems.disc(6.0))
    with pytest.raises(rk.FieldError, match="keeps the energy of a rolling scene"):
        kane.simulate(system, start, [0.0, 0.1], solver=keeping)


# -- meridians -------------------------------------------------------------------------


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize(
    "shift", [0.0, *(pytest.param(x, marks=pytest.mark.slow) for x in (1.0, 2.5))]
)
def test_the_outward_side_of_a_tube_is_outside(sense, shift):
    """Whatever way and from wherever its meridian goes round."""

    def section(s):
        s = shift + sense * s
        return 2.0 + 0.5 * jnp.cos(s), 0.5 * jnp.sin(s)

    tube = rk.Revolution(section, domain=(0.0, 2.0 * np.pi))
    for s in (0.3, 2.0, 5.0):
        place = tube.geometry(jnp.asarray([s, 0.7]))
        out = jnp.asarray(place.position + 0.1 * place.normal)
        assert rk.Torus(2.0, 0.5).signed_distance(out) > 0.05
    scene = rk.Scene(BALL, rk.Base(tube))
    start = rk.place(scene, LEVEL, STILL, (2.0, 0.0, 0.5))
    height = rk.simulate(scene, start, [0.0, 0.01]).position[0, 2]
    np.testing.assert_allclose(height, 0.6, rtol=1e-12)


def test_an_open_arch_has_its_outward_side_above():
    """Ends at one height but for rounding: it decided."""
    for domain, way in (((0.0, np.pi), 1.0), ((-np.pi, 0.0), -1.0)):
        arch = rk.Revolution(
            lambda s, way=way: (2.0 + 0.5 * jnp.cos(s), 0.5 * way * jnp.sin(s)),
            domain=domain,
        )
        middle = 0.5 * (domain[0] + domain[1])
        normal = arch.geometry(jnp.asarray([middle, 0.0])).normal
        np.testing.assert_allclose(normal, [0.0, 0.0, 1.0], atol=1e-12)


def test_a_flat_meridian_asks_for_its_side():
    with pytest.raises(rk.FieldError, match="encloses nothing"):
        rk.Revolution(lambda s: (1.0 + s, 0.0 * s), domain=(0.0, 1.0))
    flat = rk.Revolution(
        lambda s: (1.0 + s, 0.0 * s),
        domain=(0.0, 1.0),
        poles=(False, False),
        rising=False,
    )
    np.testing.assert_allclose(flat.geometry(jnp.asarray([0.5, 0.0])).normal[2], 1.0)


# -- bases that are no edge ------------------------------------------------------------


def test_a_normal_is_asked_for_at_edges_only():
    scene = rk.Scene(BALL)
    with pytest.raises(rk.FieldError, match="only a sharp edge") as caught:
        rk.place(scene, LEVEL, STILL, STILL, base_normal=(0.0, 0.0, 1.0))
    assert caught.value.field == "place.base_normal"


def system():
    velocity = lambda t, q, u: [u[0], 0.0, 0.0]
    return KaneSystem(1, 1, lambda t, q, u: u, [Particle(1.0, velocity)])


NO_NUMBERS = {
    "start of a system": lambda: simulate(
        system(), KaneState(np.array([1.0 + 2.0j]), np.zeros(1)), (0.0, 1.0)
    ),
    "samples": lambda: rk.Gyro(np.zeros((3, 3), "timedelta64[s]")),
    "masked samples": lambda: rk.Gyro(np.ma.array(np.zeros((3, 3)), mask=np.eye(3))),
    "domain": lambda: rk.Parametric(
        lambda q: [q[0], q[1], 0.0], domain=[["0", "1"], ["0", "1"]]
    ),
    "a truth value in a tensor": lambda: rk.Body(
        1.0, [[1, 0, 0], [0, True, 0], [0, 0, 1.0]], rk.Sphere(0.1)
    ),
    "mass": lambda: rk.Body(np.ma.array(1.0, mask=True), INERTIA, rk.Sphere(0.1)),
}


@pytest.mark.parametrize("name", NO_NUMBERS)
def test_what_numpy_would_make_numbers_of_is_refused(name):
    with pytest.raises(rk.FieldError, match=r"real numbers|masked"):
        NO_NUMBERS[name]()


def test_the_axes_of_a_base_at_rest_at_a_time_without_type():
    """Was: an AttributeError of a float."""
    scene, start = problems.disc(6.0)
    np.testing.assert_array_equal(base_rotation(scene, 0.0, start), np.eye(3))


@jax.custom_vjp
def wave(x):
    return jnp.sin(x)


wave.defvjp(lambda x: (jnp.sin(x), x), lambda x, g: (jnp.cos(x) * g,))
BACKWARDS = {
    "Graph.f": lambda: rk.Graph(lambda x, y: 0.1 * wave(x)),
    "Implicit.f": lambda: rk.Implicit(
        jax.jit(lambda x: x @ x - 1.0 + 0.1 * wave(x[0])), size=1.0
    ),
    "BaseMotion.position": lambda: rk.BaseMotion(
        position=lambda t: jnp.stack([wave(t), 0.0 * t, 0.0 * t])
    ),
}


@pytest.mark.parametrize("field", BACKWARDS)
def test_slopes_that_are_known_backwards_alone_are_refused(field):
    """Was: "Differentiation rule for 'custom_lin' not implemented", by place."""
    with pytest.raises(rk.FieldError, match=r"use jax\.custom_jvp") as caught:
        BACKWARDS[field]()
    assert caught.value.field == field


@pytest.mark.parametrize("dtype", [np.float16, jnp.bfloat16])
def test_half_precision_is_refused(dtype):
    """Was: "array type float16 is unsupported in linalg"."""
    with pytest.raises(rk.FieldError, match="is in half precision"):
        rk.Body(dtype(1.0), INERTIA.astype(dtype), rk.Sphere(dtype(0.1)))
