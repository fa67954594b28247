"""What Kane's functions are given: systems, shapes, names, each told by its field."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.validation.checks import FieldError


def plane(t, q, u):
    return [u[0], u[1], 0.0]


@functools.cache
def bound():
    """A particle whose second speed is the first."""
    return kane.KaneSystem(
        2,
        2,
        lambda t, q, u: u[:2],
        [kane.Particle(2.0, plane)],
        constraints=lambda t, q, u: [u[1] - u[0]],
        dependent=(1,),
    )


def state(q=2, u=1):
    return kane.KaneState(jnp.zeros(q), jnp.ones(u))


STATES = {
    "a coordinate more": (state(3), "state.q", (3,), "every coordinate"),
    "a coordinate less": (state(1), "state.q", (1,), "every coordinate"),
    "the dependent speed": (state(2, 2), "state.u", (2,), "[0], the independent ones"),
    "no speed": (state(2, 0), "state.u", (0,), "[0], the independent ones"),
    "several states": (
        jax.tree.map(lambda x: x[None], state()),
        "state.q",
        (1, 2),
        "jax.vmap",
    ),
    "numbers alone": (kane.KaneState(0.0, 0.0), "state.q", (), "every coordinate"),
    "a pair": ((0.0, 1.0), "state", (0.0, 1.0), "KaneState(q, u)"),
}
OF_A_STATE = kane.kane_derivative, kane.all_speeds, kane.reactions, kane.kinetic_energy


@pytest.mark.parametrize("function", OF_A_STATE)
@pytest.mark.parametrize("name", STATES)
def test_states_that_do_not_fit_a_system(function, name):
    given, field, value, remedy = STATES[name]
    with pytest.raises(FieldError) as told:
        function(bound(), 0.0, given)
    assert told.value.field == f"{function.__name__}.{field}"
    assert told.value.value == value
    assert remedy in told.value.remedy


@pytest.mark.parametrize("function", OF_A_STATE)
def test_times_and_systems_that_are_none(function):
    name = function.__name__
    with pytest.raises(FieldError, match=rf"^{name}\.t: must have shape \(\)"):
        function(bound(), [0.0, 1.0], state())
    with pytest.raises(FieldError, match=rf"^{name}\.t: must be made of numbers"):
        function(bound(), "now", state())
    with pytest.raises(FieldError, match=rf"^{name}\.system: must be a KaneSystem"):
        function(state(), 0.0, bound())


def test_lists_and_whole_numbers_are_states():
    """As ``simulate`` takes them."""
    whole = kane.KaneState([0, 0], [3])
    np.testing.assert_array_equal(kane.all_speeds(bound(), 0, whole), [3.0, 3.0])
    equations = kane.kane_equations(bound(), 0, [0, 0], [3, 3])
    assert equations.kinetic_energy == 18.0


def test_states_are_mapped_and_traced_as_before():
    several = kane.KaneState(jnp.zeros((3, 2)), jnp.arange(3.0)[:, None])
    speeds = jax.jit(jax.vmap(lambda s: kane.all_speeds(bound(), 0.0, s)))(several)
    np.testing.assert_array_equal(speeds, np.arange(3.0)[:, None] * np.ones(2))


NUMBERS = {
    "a coordinate more": (np.zeros(3), np.zeros(2), "q", (3,)),
    "a coordinate less": (np.zeros(1), np.zeros(2), "q", (1,)),
    "words": ("ab", np.zeros(2), "q", "ab"),
    "an independent speed": (np.zeros(2), np.zeros(1), "u", (1,)),
    "speeds that are words": (np.zeros(2), "ab", "u", "ab"),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_coordinates_and_speeds_of_equations(name):
    q, u, field, value = NUMBERS[name]
    with pytest.raises(FieldError) as told:
        kane.kane_equations(bound(), 0.0, q, u)
    assert told.value.field == f"kane_equations.{field}"
    assert told.value.value == value
    assert "every" in told.value.remedy


@functools.cache
def rolling():
    """A ball on the ground."""
    bodies = kane.free_bodies([1.0], [0.4 * np.eye(3)])
    touching = kane.RollingContact(
        bodies.frames[0], rk.Sphere(1.0), kane.ground, rk.Plane()
    )
    q = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    return kane.rolling_contacts(bodies.system, [touching], q, np.zeros(6))


@pytest.mark.parametrize("name", ["forces", "gaps", "slips"])
def test_states_that_do_not_fit_a_system_with_contacts(name):
    """Nor the times; and it is no system itself."""
    whole, start = rolling(), rolling().start
    of_state = getattr(whole, name)
    short = kane.KaneState(start.q[:-1], start.u)
    with pytest.raises(
        FieldError, match=rf"^RollingSystem\.{name}\.state\.q: must have"
    ):
        of_state(0.0, short)
    with pytest.raises(FieldError, match=r"state\.q.*for times of shape \(2,\)"):
        of_state([0.0, 1.0], start)
    with pytest.raises(FieldError, match=r"must be a KaneSystem.*give its `system`"):
        kane.kane_derivative(whole, 0.0, start)
    with pytest.raises(FieldError, match=r"^RollingSystem\.eliminated_state\.state\.q"):
        whole.eliminated_state(short)


def particle(**given):
    arguments = {"coordinates": 1, "speeds": 1, "kinematics": lambda t, q, u: u}
    return kane.KaneSystem(**(arguments | given))


def two_rows(t, q, u):
    return [u[0], q[0]]


NAMES = {
    "none": ((), "has 0 for the 2 rows that implied returns"),
    "too few": (("a",), "has 1 for the 2 rows that implied returns"),
    "too many": (("a", "b", "c"), "has 3 for the 2 rows that implied returns"),
    "one text": ("ab", "must be several texts in a row"),
    "a number": (("a", 2), "must be several texts in a row"),
    "a number alone": (2, "must be several in a row"),
}


@pytest.mark.parametrize("name", NAMES)
def test_names_of_rows_that_follow(name):
    names, says = NAMES[name]
    with pytest.raises(FieldError) as told:
        particle(implied=two_rows, implied_names=names)
    assert told.value.field == "KaneSystem.implied_names"
    assert told.value.value == names
    assert says in told.value.problem
    assert told.value.remedy


def test_names_and_numbers_of_no_rows():
    with pytest.raises(FieldError, match=r"^KaneSystem\.implied_names: has 1, and no"):
        particle(implied_names=("a",))
    for numbers in ((0.0,), "0"):
        with pytest.raises(FieldError, match=r"^KaneSystem\.dependent: must be diff"):
            particle(dependent=numbers, constraints=two_rows)


@pytest.mark.parametrize("argument", ["dependent", "dependent_coordinates"])
def test_numbers_that_do_not_fit_their_rows(argument):
    function = {"dependent": "constraints", "dependent_coordinates": "configuration"}
    rows = lambda t, q, u: [q[0], q[0]]
    with pytest.raises(FieldError) as told:
        particle(**{argument: (0,), function[argument]: rows})
    assert told.value.field == f"KaneSystem.{argument}"
    assert f"2 rows that {function[argument]} returns" in told.value.problem


CHOICES = {
    "one number alone": (0, "must be several in a row"),
    "one that there is not": ((2,), "must be different numbers of those that there"),
    "one from behind": ((-1,), "must be different numbers of those that there"),
    "one twice": ((0, 0), "must be different numbers of those that there"),
    "half a one": ((0.5,), "must be different numbers of those that there"),
    "words": ("u", "must be different numbers of those that there"),
}


@pytest.mark.parametrize("argument", ["q_ind", "u_ind"])
@pytest.mark.parametrize("name", CHOICES)
def test_rows_of_linear_models_that_cannot_be_chosen(name, argument):
    given, says = CHOICES[name]
    with pytest.raises(FieldError) as told:
        kane.linearize(bound(), 0.0, state(), **{argument: given})
    assert told.value.field == f"linearize.{argument}"
    assert told.value.value == given
    assert says in told.value.problem


def test_times_of_linear_models_are_one():
    for times, says in (([0.0, 1.0], "must have shape"), ("now", "must be made of")):
        with pytest.raises(FieldError, match=rf"^linearize\.t: {says}"):
            kane.linearize(bound(), times, state())
    found = jax.jit(lambda t: kane.linearize(bound(), t, state()).f)(0.0)
    np.testing.assert_array_equal(found, [1.0, 1.0, 0.0])


def ball_on_the_ground(q=(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0), **changed):
    bodies = kane.free_bodies([1.0], [0.4 * np.eye(3)])
    surfaces = rk.Sphere(1.0), kane.ground, rk.Plane()
    touching = kane.RollingContact(bodies.frames[0], *surfaces)
    return kane.rolling_contacts(bodies.system, [touching], q, np.zeros(6), **changed)


FREE = {
    "coordinates of no contact's": ("coordinates", (9,)),
    "coordinates from behind": ("coordinates", (-1,)),
    "coordinates that are one": ("coordinates", 0),
    "speeds that there are not": ("speeds", (6,)),
    "speeds from behind": ("speeds", (-1,)),
    "speeds that are words": ("speeds", "u"),
}


@pytest.mark.parametrize("name", FREE)
def test_what_should_stay_free_of_contacts_is_there(name):
    what, given = FREE[name]
    with pytest.raises(FieldError) as told:
        ball_on_the_ground(**{f"independent_{what}": given})
    assert told.value.field == f"rolling_contacts.independent_{what}"
    assert told.value.value == given


def test_a_quaternion_of_zeros():
    """Its body's axes are not numbers, wherever contacts are looked for first."""
    nowhere = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(
        FieldError, match=r"^rolling_contacts\.q: .*mass matrix"
    ) as told:
        ball_on_the_ground(nowhere)
    assert "quaternion" in told.value.remedy


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (0.0, 0.0, 0.0)])
def test_free_bodies_have_no_parameters(gravity):
    """Their masses are numbers."""
    inertia, of_parameters = 0.4 * np.eye(3), lambda p: p["m"]
    with pytest.raises(FieldError, match=r"^free_bodies\.masses\[1\]: is a function"):
        kane.free_bodies([1.0, of_parameters], [inertia, inertia], gravity)
    with pytest.raises(FieldError, match=r"^free_bodies\.inertias\[0\]: is a function"):
        kane.free_bodies([1.0], [of_parameters], gravity)


def pair(constraints, dependent):
    point = lambda t, q, u: [u[0], u[1], 0.0]
    parts = [kane.Particle(1.0, point)]
    return kane.KaneSystem(
        *(2, 2, lambda t, q, u: u, parts),
        constraints=constraints,
        dependent=dependent,
    )


def test_numbers_of_constraints_that_determine_no_motion():
    driven, none = pair(lambda t, q, u: [u[0] - 1.0, u[1]], (0, 1)), jnp.zeros(0)
    with pytest.raises(FieldError, match=r"KaneSystem.dependent: are all 2 speeds"):
        kane.simulate(driven, kane.KaneState(jnp.zeros(2), none), (0.0, 1.0))
    with pytest.raises(FieldError, match=r"KaneSystem.dependent: are all 2 speeds"):
        kane.linearize(driven, 0.0, kane.KaneState(jnp.zeros(2), none))
    with pytest.raises(FieldError, match=r"KaneSystem.constraints: returns no rows"):
        pair(lambda t, q, u: jnp.zeros(0), None)
    many = pair(lambda t, q, u: [u[0], u[1], u[0] + u[1]], None)
    start = kane.KaneState(jnp.zeros(2), jnp.zeros(2))
    with pytest.raises(FieldError, match=r"KaneSystem.constraints: follow from each"):
        kane.simulate(many, start, (0.0, 1.0))


def test_a_linear_model_at_no_time():
    system = pair(lambda t, q, u: [u[1] - t * u[0]], (1,))
    state = kane.KaneState(jnp.zeros(2), jnp.zeros(1))
    with pytest.raises(FieldError, match=r"linearize.t: must be finite"):
        kane.linearize(system, np.nan, state)


@pytest.mark.parametrize(
    "turn",
    [
        np.diag([1.0, 1.0, -1.0]),
        2.0 * np.eye(3),
        [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    ],
)
def test_axes_of_contacts_are_turned_alone(turn):
    """A mirrored plane would have its ball below it, and pull it."""
    bodies = kane.free_bodies([1.0], [0.04 * np.eye(3)])
    plate = kane.Frame(None, lambda t, q, u: jnp.asarray(turn))
    (ball,) = bodies.frames
    contact = kane.RollingContact(ball, rk.Sphere(0.3), plate, rk.Plane())
    q = [0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]
    with pytest.raises(FieldError, match=r"\[0\].body_b.rotation: is no rotation"):
        kane.rolling_contacts(bodies.system, [contact], q=q, u=np.zeros(6))


def test_contacts_at_no_time():
    bodies = kane.free_bodies([1.0], [0.04 * np.eye(3)])
    (ball,) = bodies.frames
    contact = kane.RollingContact(ball, rk.Sphere(0.3), kane.ground, rk.Plane())
    q = [0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]
    with pytest.raises(FieldError, match=r"rolling_contacts.time: must be finite"):
        kane.rolling_contacts(bodies.system, [contact], q=q, u=np.zeros(6), time=np.nan)
