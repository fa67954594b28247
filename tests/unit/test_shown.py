"""What a body, a scene, a state and a run show of themselves: numbers, with units."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.export import to_xarray

BODY = rk.Body(2.0, np.diag([0.1, 0.2, 0.3]), rk.Sphere(0.5), (0.0, 0.0, -0.1))
SCENE = rk.Scene(BODY, rk.Base(motion=rk.Spin(3.0)))
LEVEL, DOWN = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
START = rk.place(SCENE, LEVEL, (0.0, 4.0, 0.0), DOWN)
TIMES = np.linspace(0.0, 1.0, 5)


@pytest.fixture(scope="module")
def dropped():
    """A ball that falls with a spin, rebounds and grips."""
    ball = rk.Scene(rk.Body(2.0, 0.008 * np.eye(3), rk.Sphere(0.1)))
    start = rk.release(ball, LEVEL, (0.0, 5.0, 0.0), (0.0, 0.0, 0.2), (0.2, 0.0, 0.0))
    modes = rk.Modes(friction=0.1, restitution=0.2)
    return rk.simulate(ball, start, TIMES, modes=modes)


SHOWN = {
    "a body": (
        BODY,
        "Body( mass=2 kg, center_of_mass=(0, 0, -0.1) m, inertia=diag(0.1, 0.2, 0.3) "
        "kg m^2, surface=Sphere(radius=0.5 m, center=(0, 0, 0) m), )",
    ),
    "a base": (SCENE.base, "Base(surface=Plane(), motion=Spin(rate=3 rad/s))"),
    "a state": (
        START,
        "State( orientation=(1, 0, 0, 0), angular_velocity=(0, 4, 0) rad/s, "
        "contact_on_base=(0, 0), )",
    ),
    "a surface": (
        rk.Torus(0.2, 0.05),
        "Torus(major_radius=0.2 m, minor_radius=0.05 m)",
    ),
    "a plane": (rk.Plane(), "Plane()"),
    "a function": (
        rk.Graph(jnp.hypot, domain=((-1, 1), (0, 2))),
        "Graph(f=hypot, domain=((-1, 1), (0, 2)))",
    ),
}


@pytest.mark.parametrize("name", SHOWN)
def test_numbers_with_units(name):
    value, text = SHOWN[name]
    assert " ".join(repr(value).split()) == text
    assert len(repr(value).split("\n")) <= 7


def test_a_scene_holds_its_parts():
    lines = repr(SCENE).split("\n")
    assert lines[0] == "Scene("
    assert lines[1].startswith("  body=Body(mass=2 kg, ")
    assert lines[2] == "  base=Base(surface=Plane(), motion=Spin(rate=3 rad/s)),"
    assert "  loads=(Gravity(acceleration=(0, 0, -9.81) m/s^2),)," in lines
    assert len(lines) <= 7


def test_what_has_no_numbers_is_shown_too():
    """Batches by type and shape, traced values as such, and trees of anything."""
    many = jax.tree.map(lambda x: jnp.stack(5 * [x]), START)
    assert "orientation=float64[5, 4]," in repr(many)
    assert "mass=None" not in repr(jax.tree.map(lambda x: None, BODY))
    assert "mass='kg'" in repr(jax.tree.map(lambda x: "kg", BODY))
    seen = []
    jax.eval_shape(lambda body: seen.append(repr(body)) or body.mass, BODY)
    assert "inertia=traced float64[3, 3] kg m^2" in seen[0]
    refused = rk.FieldError("a", START, "is wrong", "do better")
    assert "\n" not in str(refused)


def test_a_run_tells_how_it_ended():
    run = rk.simulate(SCENE, START, TIMES)
    first, when, how, what, end, last = repr(run).split("\n")
    assert (first, when) == ("Trajectory(", "  time=0 to 1 s in 5 outputs,")
    steps = f"{int(run.steps)} steps ({run.method})"
    assert how == f"  code=0 (completed), final_time=1 s, {steps},"
    assert what == "  scene=Sphere of 2 kg on Plane,"
    assert end.startswith("  final_state=State(orientation=(")
    assert last == ")"
    batch = jax.vmap(lambda _: rk.simulate(SCENE, START, TIMES))(jnp.arange(2))
    assert "steps=(" in repr(batch)


def test_modes_are_an_enum_that_arrays_compare_with(dropped):
    assert [mode.name for mode in rk.Mode] == ["ROLLING", "SLIPPING", "FLYING"]
    assert isinstance(rk.Mode.FLYING, int)
    assert rk.Mode(int(dropped.mode[0])) is rk.Mode.FLYING
    np.testing.assert_array_equal(dropped.mode == rk.Mode.FLYING, dropped.mode == 2)
    assert (dropped.mode == rk.Mode.ROLLING)[-1]


def test_changes_are_told_and_kept_in_a_data_set(dropped):
    switches = dropped.switches
    count = int(switches.count)
    assert count >= 3  # rebounds, and grips
    text = repr(switches).split("\n")
    assert text[0] == f"Switches(count={count},"
    assert text[1].startswith("  flies -> flies at 0.1")  # of 0.1 m: 0.143 s
    assert " -> rolls at " in text[-2]
    assert len(text) == count + 2
    data = to_xarray(dropped)
    assert data["switch_time"].shape == (count,)
    assert data["switch_time"].units == "s"
    for name in ("time", "before", "after"):
        kept = np.asarray(getattr(switches, name))[:count]
        np.testing.assert_array_equal(data[f"switch_{name}"], kept)
    np.testing.assert_array_equal(data["mode"], dropped.mode)
    assert "State(orientation=" in repr(dropped).split("final_state=")[1]
    assert "parts" not in repr(dropped)


def test_changes_of_a_batch_in_a_data_set(dropped):
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), dropped)
    data = to_xarray(batch)
    assert data["switch_time"].dims == ("lane", "switch")
    np.testing.assert_array_equal(data["switch_count"], batch.switches.count)
    assert "Switches(" in repr(batch.switches)
