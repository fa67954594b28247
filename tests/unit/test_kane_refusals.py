"""Kane systems that are not what they say, and auxiliary speeds beside SymPy's."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.kane.singular_states import refuse_start
from rollkane.validation.checks import FieldError

G = 9.81
plane = lambda t, q, u: [u[0], u[1], 0.0]
weight = lambda t, q, u: jnp.array([0.0, -G, 0.0])


def numbered(system, parameters):
    """The same system with other parameters: one program for all of them."""
    return eqx.tree_at(lambda s: s.parameters, system, parameters)


# ---- configuration -------------------------------------------------------------------

# a bead on a circle about the origin: radius rod + grows t + later t^2, of whose rate
# the constraint knows `follows`; the level moves with `wind`, of which it knows `heeds`
# times as much; `sideways` is the part of x in the constraint, one where it is right
CIRCLE = {
    "rod": 2.0,
    "grows": 0.0,
    "later": 0.0,
    "follows": 0.0,
    "wind": 0.0,
    "heeds": 1.0,
    "sideways": 1.0,
}


def radius(t, p):
    return p["rod"] + p["grows"] * t + p["later"] * t**2


def drift(t, q, u, p):
    return [u[0] + p["wind"], u[1]]


def along_circle(t, q, u, p):
    x_dot = u[0] + p["heeds"] * p["wind"]
    return [p["sideways"] * q[0] * x_dot + q[1] * u[1] - radius(t, p) * p["follows"]]


def on_circle(t, q, u, p):
    return [0.5 * (q[0] ** 2 + q[1] ** 2 - radius(t, p) ** 2)]


def bead(parameters=None, **changed):
    arguments = {
        "coordinates": 2,
        "speeds": 2,
        "kinematics": drift,
        "parts": [kane.Particle(1.0, plane)],
        "loads": [kane.Load(plane, weight)],
        "constraints": along_circle,
        "dependent": (1,),
        "configuration": on_circle,
        "dependent_coordinates": (1,),
        "parameters": {**CIRCLE, **(parameters or {})},
    }
    return kane.KaneSystem(**{**arguments, **changed})


def at_angle(angle=0.3, length=2.0, u=(0.4,)):
    place = length * np.array([np.sin(angle), -np.cos(angle)])
    return kane.KaneState(jnp.asarray(place), jnp.asarray(u, float))


def simulated(system, state, t=0.0):
    return kane.simulate(system, state, np.linspace(t, t + 1.0, 3))


def linearized(system, state, t=0.0):
    return kane.linearize(system, t, state)


BOTH = pytest.mark.parametrize("ask", [simulated, linearized])
VIOLATED = {  # parameters, angle and length of the start, time, words
    "another length": ({}, (0.3, 2.2), 0.0, r"is not zero at t = 0, q = .*0\.41999"),
    "a millionth longer": (
        {},
        (0.3, 2.0 + 2e-6),
        0.0,
        r"is not zero.* might be left, got \[4\.0",
    ),
    "the length of another time": (
        {"grows": 0.5, "follows": 0.5},
        (0.3, 2.0),
        1.0,
        r"is not zero at t = 1.*first order, q\[\[1\]\] = \[-2\.49",
    ),
    "a micrometre that is another": (
        {"rod": 1.01e-6},
        (0.3, 1e-6),
        0.0,
        "is not zero at t = 0",
    ),
    "a rate with another number": (
        {"sideways": 1.001},
        (0.3, 2.0),
        0.0,
        r"is not kept by the velocity constraints.*got \[-0\.00059",
    ),
    "at a place where the rate is right by chance": (
        {"sideways": 0.0},
        (0.0, 2.0),
        0.0,
        r"is not kept by the velocity constraints.*got \[0\.0, 0\.0, ",
    ),
    "a moving one, without its rate": (
        {"grows": 0.5},
        (0.3, 2.0),
        0.0,
        r"is not kept.*, -1\.0, ",
    ),
    "one that begins to move": (
        {"later": 0.5},
        (0.3, 2.0),
        0.0,
        r"is not kept.*, -?0\.0, -2\.0",
    ),
    "a drift of the coordinates": (
        {"wind": 0.5, "heeds": 0.0},
        (0.3, 2.0),
        0.0,
        "is not kept",
    ),
}


@BOTH
@pytest.mark.parametrize("case", VIOLATED.values(), ids=list(VIOLATED))
def test_a_violated_configuration_is_refused(case, ask):
    parameters, place, t, words = case
    with pytest.raises(FieldError, match="KaneSystem.configuration: " + words):
        ask(bead(parameters), at_angle(*place), t)


KEPT = {
    "a bead": ({}, (0.3, 2.0), 0.0),
    "at the bottom": ({}, (0.0, 2.0), 0.0),
    "rounded": ({}, (0.3, 2.0 * (1.0 + 1e-8)), 0.0),
    "small": ({"rod": 1e-6}, (0.3, 1e-6), 0.0),
    "large": ({"rod": 1e7}, (0.3, 1e7), 0.0),
    "moving": ({"grows": 0.5, "follows": 0.5}, (0.3, 2.0), 0.0),
    "moving, at another time": ({"grows": 0.5, "follows": 0.5}, (0.3, 2.5), 1.0),
    "drifting": ({"wind": 0.5}, (0.3, 2.0), 0.0),
}


@pytest.mark.parametrize("case", KEPT.values(), ids=list(KEPT))
def test_a_kept_configuration_is_not(case):
    parameters, place, t = case
    found = linearized(bead(parameters), at_angle(*place), t)
    assert np.isfinite(np.asarray(found.A)).all()


def test_a_moving_configuration_is_kept_and_a_loose_run_starts_loosely():
    """300 steps of 1e-9; a start that is as exact as the tolerance asks for is one."""
    system = bead({"grows": 0.5, "follows": 0.5})
    run = simulated(system, at_angle())
    kept = jax.vmap(lambda t, q: system.at(system.configuration, t, q, jnp.zeros(2)))
    np.testing.assert_allclose(kept(run.time, run.q), 0.0, atol=1e-8)
    rough = at_angle(length=2.0 + 2e-6)
    assert kane.simulate(system, rough, [0.0, 1.0, 2.0], rtol=1e-7).succeeded


FREE = {
    "no constraint": (
        {"constraints": None, "dependent": ()},
        r"configuration: is not kept.*\(0, 1\)",
    ),
    "zero with its square": (
        {"configuration": lambda t, q, u, p: [on_circle(t, q, u, p)[0] ** 2]},
        r"configuration: has derivatives by the coordinates that are zero",
    ),
    "no values": (
        {"configuration": lambda t, q, u, p: [jnp.sqrt(q[0] - 3.0)]},
        r"configuration: has no value",
    ),
    "a coordinate that it does not determine": (
        {
            "configuration": lambda t, q, u, p: [q[0] + 0.0 * q[1]],
            "constraints": lambda t, q, u, p: [u[0]],
            "dependent": (0,),
        },
        r"dependent_coordinates: are not determined",
    ),
}


@pytest.mark.parametrize(("changed", "words"), FREE.values(), ids=list(FREE))
def test_coordinates_that_cannot_be_eliminated(changed, words):
    system = bead(**changed)
    state = at_angle(0.0, u=np.full(len(system.independent), 0.4))
    with pytest.raises(FieldError, match="KaneSystem." + words):
        linearized(system, state)


def test_a_free_coordinate_is_refused_before_it_drifts():
    with pytest.raises(FieldError, match="configuration: is not kept"):
        simulated(bead(constraints=None, dependent=()), at_angle(u=(0.4, 0.1)))


@jax.jit
def with_both(q, u):
    """Two things from one program."""
    return {"place": jnp.sin(q), "moved": q * u}


LOOKS = {
    "by a speed": lambda t, q, u, p: [q[0] + u[0]],
    "times zero": lambda t, q, u, p: [q[0] + 0.0 * u[0]],
    "where a coordinate is zero": lambda t, q, u, p: [q[0] * u[0]],
    "by a choice": lambda t, q, u, p: [jnp.where(u[0] > 0.0, q[0], -q[0])],
    "by a branch": lambda t, q, u, p: [
        jax.lax.cond(q[0] > 0.0, lambda: q[0], lambda: u[0])
    ],
    "inside of a program": lambda t, q, u, p: [with_both(q, u)["moved"][0]],
}


@pytest.mark.parametrize("configuration", LOOKS.values(), ids=list(LOOKS))
def test_a_configuration_looks_at_no_speeds(configuration):
    """Said when the system is made, known numbers or not."""
    with pytest.raises(FieldError, match="configuration: looks at the speeds u"):
        bead(configuration=configuration)
    with pytest.raises(FieldError, match="configuration: looks at the speeds u"):
        jax.vmap(lambda r: bead({"rod": r}, configuration=configuration).parameters)(
            jnp.ones(2)
        )


def test_a_configuration_may_share_a_program_with_speeds():
    def shared(t, q, u, p):
        return {**p, **with_both(q, u)}

    def configuration(t, q, u, now):
        size = jnp.sum(now["place"] ** 2) + jnp.zeros_like(u)[0]
        return [size - 0.0 * radius(t, now)]

    bead(shared=shared, configuration=configuration)
    jax.vmap(lambda r: bead({"rod": r}).parameters)(jnp.ones(2))


def test_nothing_is_said_of_traced_numbers():
    """What is known in a trace is refused; what is mapped or traced gives numbers."""
    system, wrong = bead(), at_angle(length=2.2)

    @jax.jit
    def shapes(q, radii):
        matrix = lambda system, q: (
            kane.linearize(system, 0.0, kane.KaneState(q, wrong.u)).A
        )
        of_radius = lambda r: matrix(numbered(system, {**CIRCLE, "rod": r}), wrong.q)
        return matrix(system, q), jax.vmap(of_radius)(radii)

    alone, mapped = shapes(wrong.q, jnp.array([2.0, 2.2]))
    # on a rod of 2.2 m it stays; to one of 2 m it is moved, below the same place
    longer = numbered(system, {**CIRCLE, "rod": jnp.asarray(2.2)})
    kept = kane.linearize(longer, 0.0, wrong).A
    below = at_angle(np.arcsin(1.1 * np.sin(0.3)))
    moved = kane.linearize(system, 0.0, below).A
    np.testing.assert_allclose(mapped, [alone, kept], rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(alone, moved, rtol=1e-12, atol=1e-12)


def test_known_numbers_inside_jit_are_refused():
    square = lambda t, q, u: [u[0] + 1e-4 * u[0] ** 2, 0.0, 0.0]
    system = kane.KaneSystem(1, 1, lambda t, q, u: u, [kane.Particle(1.0, square)])
    start = kane.KaneState(jnp.zeros(1), jnp.zeros(1))
    with pytest.raises(FieldError, match="is not affine in the speeds"):
        jax.jit(lambda x: linearized(system, start) and x)(1.0)


# ---- affine velocities ---------------------------------------------------------------

BENT = {  # zero at zero
    "u^2": lambda t, q, u: 1e-4 * u[0] ** 2,
    "a small u^2": lambda t, q, u: 1e-10 * u[0] ** 2,
    "u^3": lambda t, q, u: 1e-6 * u[1] ** 3,
    "a product": lambda t, q, u: 1e-6 * u[0] * u[1],
    "abs": lambda t, q, u: 1e-3 * jnp.abs(u[0]),
    "affine near zero": lambda t, q, u: jnp.where(jnp.abs(u[1]) < 50.0, 0.0, u[1]),
    "affine far from zero": lambda t, q, u: 1e-3 * jnp.tanh(1e3 * u[1]),
    "the size of a vector": lambda t, q, u: 1e-3 * jnp.sqrt(u[0] ** 2 + u[1] ** 2),
    "a jump": lambda t, q, u: 1e-3 * jnp.sign(u[0]),
    "at another place": lambda t, q, u: q[0] * u[1] ** 2,
    "at another time": lambda t, q, u: t * u[0] * u[1],
}
SINGLE = ["u^2", "u^3", "abs", "affine near zero", "a jump"]
PLACES = [
    "parts[0].velocity",
    "parts[1].angular_velocity",
    "loads[0].velocity",
    "constraints",
    "kinematics",
]


def bent(size, t, q, u):
    """All of the curves, each as large as its number says."""
    curves = [size[k] * f(t, q, u) for k, f in enumerate(BENT.values())]
    return sum(jnp.where(size[k] != 0.0, x, 0.0) for k, x in enumerate(curves))


def moving(place):
    return lambda t, q, u, p: [u[0] + bent(p[place], t, q, u), u[1] - jnp.cos(t), 0.0]


@functools.cache
def bent_system():
    """A system that is bent where its parameters say."""

    def constraint(t, q, u, p):
        return [u[2] - q[1] * u[0] - 1.0 + bent(p["constraints"], t, q, u)]

    def kinematics(t, q, u, p):
        return [u[0], u[1] + bent(p["kinematics"], t, q, u), u[2]]

    turning = kane.RigidBody(1.0, np.eye(3), plane, moving(PLACES[1]))
    return kane.KaneSystem(
        3,
        3,
        kinematics,
        [kane.Particle(1.0, moving(PLACES[0])), turning],
        [kane.Load(moving(PLACES[2]), weight)],
        constraints=constraint,
        dependent=(2,),
        parameters=sizes(),
    )


def sizes(place="", curve=""):
    """Parameters with one curve at one place."""
    one = lambda at: [at == place and name == curve for name in BENT]
    return {at: jnp.asarray(one(at), float) for at in PLACES}


BENT_START = np.zeros(3), np.array([0.1, -0.2])


CURVES = [(PLACES[0], curve) for curve in BENT] + [(at, "u^2") for at in PLACES[1:]]


@pytest.mark.parametrize(("place", "curve"), CURVES)
def test_velocities_that_are_not_affine(place, curve):
    system = numbered(bent_system(), sizes(place, curve))
    with pytest.raises(FieldError) as refused:
        kane.simulate(system, kane.KaneState(*BENT_START), [0.0, 1.0])
    assert refused.value.field == f"KaneSystem.{place}"
    assert "is not affine in the speeds at t = 0" in refused.value.problem
    assert 0.0 < refused.value.value <= 2.0  # of its size


@pytest.mark.parametrize("curve", ["", *SINGLE])
def test_in_single_precision(curve):
    with jax.enable_x64(False):
        made = bent_system.__wrapped__()  # others are to have it in double precision
        system = jax.tree.map(lambda x: jnp.asarray(x, float), made)
        system = numbered(system, sizes(PLACES[0], curve))
        state = kane.KaneState(*(jnp.asarray(x, float) for x in BENT_START))
        if not curve:
            refuse_start(system, 0.0, state)
            return
        with pytest.raises(FieldError, match="is not affine in the speeds"):
            refuse_start(system, 0.0, state)


def at_rest(t, q, u):
    """Velocity of a point at rest: a sum of roundings."""
    S, C = np.sin(0.3), np.cos(0.3)
    nothing = jnp.sin(q[0] + 0.3) - jnp.sin(q[0]) * C - jnp.cos(q[0]) * S
    return u[0] * nothing * jnp.ones(3)


def by_squares(t, q, u):
    """Squares that cancel."""
    return [((u[0] + 1.0) ** 2 - (u[0] - 1.0) ** 2) / 4.0, u[1], 0.0]


def affine():
    """Systems that are, with states."""
    draw = np.random.default_rng(5).standard_normal
    state = kane.KaneState(jnp.asarray(draw(2)), jnp.asarray(draw(2)))
    still = lambda t, q, u: 0.0
    yield kane.bar_on_frame(1.3, 0.9, 0.6, still, still), state
    parts, loads = [kane.Particle(1.0, by_squares)], [kane.Load(at_rest, weight)]
    yield kane.KaneSystem(2, 2, lambda t, q, u: u, parts, loads), state
    body = rk.Body(1.0, 0.1 * np.eye(3), rk.Ellipsoid((0.3, 0.2, 0.25)))
    scene = rk.Scene(body, loads=(rk.Gravity(),))
    state = rk.place(scene, (0.8, 0.6, 0.0, 0.0), (1.0, 2.0, 3.0), np.zeros(3))
    yield kane.rolling_system(scene, state, reactions=True), kane.kane_state(state)


def test_what_is_affine_is_not_refused():
    """A contact that is lifted by auxiliary speeds among it."""
    for system, state in affine():
        refuse_start(system, 0.1, state)


# ---- auxiliary speeds ----------------------------------------------------------------


@functools.cache
def lifted_bead(dependent=(1,)):
    """A bead on a parabola that moves up; the constraint names its lift or not.

    So do the kinematics. Parameters: how much of it.
    """
    velocity = lambda t, q, u: [u[0] + q[0] * q[1] * u[2], u[1] + u[2], 0.0]
    force = lambda t, q, u: [0.3 - 2.0 * u[0] - 3.0 * u[2], -1.5 * G, 0.0]
    return kane.KaneSystem(
        2,
        2,
        lambda t, q, u, p: [u[0] + p[1] * q[1] * u[2], u[1] + p[1] * u[2]],
        [kane.Particle(1.5, velocity)],
        [kane.Load(velocity, force)],
        constraints=lambda t, q, u, p: [u[1] + p[0] * u[2] - q[0] * u[0] - jnp.cos(t)],
        dependent=dependent,
        auxiliary=1,
        parameters=jnp.zeros(2),
    )


@functools.cache
def wheel(dependent=(1, 2)):
    """A wheel with two constraints, which name two auxiliary speeds."""
    velocity = lambda t, q, u: [u[1] + u[3], u[2] + u[4] + 0.3 * u[3], 0.0]
    spin = lambda t, q, u: [0.0, 0.0, u[0] + 0.1 * u[4]]

    def constraints(t, q, u, p):
        rolled = 0.5 * (1.0 + jnp.sin(q[0]) / 5.0) * u[0]
        rises = u[1] * jnp.cos(q[0]) / 5.0 + jnp.sin(t)
        return [
            u[1] + rolled + p[0] * u[3],
            u[2] - rises + p[1] * u[4] + 0.5 * p[0] * u[4],
        ]

    return kane.KaneSystem(
        3,
        3,
        lambda t, q, u: [u[1], u[2], u[0]],
        [kane.RigidBody(1.5, 0.4 * np.eye(3), velocity, spin)],
        [
            kane.Load(velocity, lambda t, q, u: jnp.array([0.3, -1.5 * G, 0.0])),
            kane.Load(spin, lambda t, q, u: jnp.array([0.0, 0.0, 2.0])),
        ],
        constraints=constraints,
        dependent=dependent,
        auxiliary=2,
        parameters=jnp.zeros(2),
    )


# by SymPy 1.14: the right-hand sides of KanesMethod, less its auxiliary_eqs with
# auxiliary speeds and their rates zero, at t = 0.4 s
BY_SYMPY = [
    (lifted_bead, (0.0, 0.0), [-5.84434485036954], [8.36734176578261]),
    (lifted_bead, (1.0, 0.0), [-5.84434485036954], [-1.44196862786640]),
    (lifted_bead, (0.5, 1.0), [-5.84434485036954], [3.46268656895810]),
    (wheel, (0.0, 0.0), [3.66604539174777], [1.34234747341190, 15.5059378988834]),
    (wheel, (1.0, 1.0), [3.66604539174777], [2.28770761518565, -7.83300622593682]),
    (wheel, (-1.0, 2.0), [3.66604539174777], [0.396987331638155, -7.83300622593682]),
]


@eqx.filter_jit
def accelerations_and_reactions(system, state):
    rates = kane.kane_derivative(system, 0.4, state)
    return rates.u, kane.reactions(system, 0.4, state)


@pytest.mark.parametrize(("make", "numbers", "u_dot", "force"), BY_SYMPY)
def test_auxiliary_speeds_in_constraints_as_in_sympy(make, numbers, u_dot, force):
    """Sums of a dozen terms of order ten: 1e-13, and SymPy's 15 digits."""
    system = numbered(make(), jnp.asarray(numbers))
    q = jnp.array([0.7, 0.3, 0.2][: system.coordinates])
    chosen = kane.KaneState(q, jnp.array([1.1]))
    whole = kane.KaneState(q, kane.all_speeds(system, 0.4, chosen))
    by_multipliers = numbered(make(None), jnp.asarray(numbers))
    for each, state in ((system, chosen), (by_multipliers, whole)):
        found = accelerations_and_reactions(each, state)
        np.testing.assert_allclose(found[0][:1], u_dot, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found[1], force, rtol=0, atol=1e-12)


def crank(closed):
    """Masses at the ends of a crank and of a rod on it, on a hinge that may be lifted.

    The closed chain's end is held on a level line, which knows of the lift as far as
    the parameters say; they have a force on that end, too.
    """

    def pin(t, q, u, p, lift=1.0):
        return [-u[0] * jnp.sin(q[0]), u[0] * jnp.cos(q[0]) + lift * u[2], 0.0]

    def end(t, q, u, p, lift=1.0):
        x, y, _ = pin(t, q, u, p, lift)
        return [x - 2.0 * u[1] * jnp.sin(q[1]), y + 2.0 * u[1] * jnp.cos(q[1]), 0.0]

    def level(t, q, u, p):
        return [end(t, q, u, p, p["lift"])[1]]

    return kane.KaneSystem(
        2,
        2,
        lambda t, q, u: u[:2],
        [kane.Particle(2.0, pin), kane.Particle(3.0, end)],
        [
            kane.Load(pin, lambda t, q, u: [0.0, -2.0 * G, 0.0]),
            kane.Load(end, lambda t, q, u, p: [0.0, p["force"] - 3.0 * G, 0.0]),
        ],
        constraints=level if closed else None,
        dependent=(1,) if closed else (),
        auxiliary=1,
        parameters={"lift": 1.0, "force": 0.0},
    )


def test_the_reaction_of_a_hinge_in_a_closed_chain():
    """A crank and a rod whose end slides on a level line.

    With the hinge's lift in the constraint its reaction is the hinge's force alone;
    left out, the line gives way, too, and its force is added: with that force, the
    open chain moves the same way, and has the same force in its hinge.
    """
    q = jnp.array([0.9, -np.arcsin(np.sin(0.9) / 2.0)])
    state = kane.KaneState(q, jnp.array([1.7]))
    named = crank(closed=True)
    left_out = numbered(named, {"lift": jnp.asarray(0.0), "force": jnp.asarray(0.0)})
    moved, (hinge,) = accelerations_and_reactions(named, state)
    _, (both,) = accelerations_and_reactions(left_out, state)
    assert abs(both - hinge) > 1.0
    slope = -np.cos(0.9) / (2.0 * np.cos(q[1]))
    whole = kane.KaneState(q, 1.7 * jnp.array([1.0, slope]))
    pushed = {"lift": jnp.asarray(1.0), "force": both - hinge}
    freely, (found,) = accelerations_and_reactions(
        numbered(crank(closed=False), pushed), whole
    )
    # terms of order 100 through some twenty operations
    np.testing.assert_allclose(freely[:1], moved, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found, hinge, rtol=0, atol=1e-11)


def test_auxiliary_speeds_are_zero():
    system, q = lifted_bead(), jnp.array([0.7, 0.3])
    u = jnp.array([1.1, 0.5, 0.0])
    forcing = jax.jit(lambda u: kane.kane_equations(system, 0.4, q, u).forcing)
    np.testing.assert_array_equal(forcing(u[:2]), forcing(u))
    with pytest.raises(FieldError, match=r"auxiliary speeds that are not zero.*0\.3"):
        kane.kane_equations(system, 0.4, q, jnp.array([1.1, 0.5, 0.3]))
    with pytest.raises(FieldError, match=r"kane_equations.u: must have shape \(2,\)"):
        kane.kane_equations(system, 0.4, q, jnp.array([1.1]))


def particle(**given):
    """A particle along x, of one coordinate and one speed."""
    along = lambda t, q, u: [u[0], 0.0, 0.0]
    arguments = {"coordinates": 1, "speeds": 1, "kinematics": lambda t, q, u: u}
    arguments["parts"] = [kane.Particle(1.0, along)]
    return kane.KaneSystem(**(arguments | given))


UNFIT = {
    "parts": kane.Particle(1.0, plane),
    "loads": kane.Load(plane, weight),
    "dependent": 0,
    "dependent_coordinates": 1,
    "coordinates": 1.0,
    "speeds": 0,
    "auxiliary": -1,
}


@pytest.mark.parametrize("name", UNFIT)
def test_arguments_of_another_kind_are_refused_by_name(name):
    with pytest.raises(FieldError, match=rf"^KaneSystem\.{name}: must be"):
        particle(**{name: UNFIT[name]})


def test_states_of_another_kind_are_refused_by_linearize():
    one, two = jnp.zeros(1), jnp.zeros(2)
    for state, field in (
        ((one, one), "state"),
        (kane.KaneState(two, one), r"state\.q"),
        (kane.KaneState(one * jnp.nan, one), "state"),
    ):
        with pytest.raises(FieldError, match=rf"^linearize\.{field}: must"):
            kane.linearize(particle(), 0.0, state)


def test_one_mass_is_not_several():
    with pytest.raises(FieldError, match=r"^free_bodies\.masses: must be several"):
        kane.free_bodies(1.0, [np.eye(3)])
