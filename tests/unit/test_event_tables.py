"""Events in scene files, in studies and on the command line."""

from typing import get_args

import click.testing
import jax
import jax.numpy as jnp
import pytest

import rollkane as rk
from rollkane.cli.commands import main
from rollkane.dynamics.ready_observables import READY, SCALARS
from rollkane.files.scene_files import SceneFileError, load_scene, scene_schema
from rollkane.files.scene_files.tables import LIFT_OFF, EventTable
from rollkane.uncertainty.study_file import load_study

OFF_A_BALL = """\
title = "a ball that rolls off a ball"

[body]
mass = 1.0
inertia = [[0.004, 0.0, 0.0], [0.0, 0.004, 0.0], [0.0, 0.0, 0.004]]
center_of_mass = [0.0, 0.0, 0.0]
surface = { kind = "sphere", radius = 0.1 }
[base]
surface = { kind = "sphere", radius = 1.0 }
[start]
orientation = [1.0, 0.0, 0.0, 0.0]
angular_velocity = [0.0, 0.1, 0.0]
contact_on_base = [0.0, 0.0, 1.0]
[run]
duration = 2.6
outputs = 3
[[events]]
name = "turned over"
of = "tilt"
level = 1.5
direction = 1
[[events]]
of = "lift-off"
"""


@pytest.fixture
def scene_path(tmp_path):
    path = tmp_path / "off.toml"
    path.write_text(OFF_A_BALL, encoding="utf-8")
    return path


def run(*arguments):
    return click.testing.CliRunner().invoke(main, [str(x) for x in arguments])


def test_numbers_that_cross_a_level_are_those_of_the_table(scene_path):
    known = get_args(EventTable.model_fields["of"].annotation)
    assert known == (LIFT_OFF, *SCALARS)
    file = load_scene(scene_path)
    scalars = {
        name
        for name, function in READY.items()
        if function(file.scene, jnp.zeros(()), file.start).shape == ()
    }
    assert scalars == set(SCALARS)
    assert "EventTable" in scene_schema()["$defs"]


def test_events_of_a_scene_file_are_found(scene_path):
    file = load_scene(scene_path)
    assert [event.name for event in file.events] == ["turned over", "lift-off"]
    assert [event.direction for event in file.events] == [1, -1]
    assert not any(event.stop for event in file.events)
    found = rk.simulate(file.scene, file.start, file.times, events=file.events)
    time = found.events["turned over"].times[0]
    angle = READY["tilt"](file.scene, time, at(found.events["turned over"].states))
    # an event ends a step to some four roundings of the clock; the tilt moves at most
    # some 10 rad/s
    assert abs(angle - 1.5) < 1e-13
    assert found.events["lift-off"].count == 1


def at(states):
    return jax.tree.map(lambda x: x[0], states)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ('of = "lift-of"', r"events\[2\]\.of: is not a known name"),
        ('of = "spin"\nlevl = 1.0', r"events\[2\]\.levl: is an unknown name"),
        ('of = "spin"\nlevel = "high"', r"events\[2\]\.level: must be a number"),
        ('of = "spin"\ndirection = 2', r"events\[2\]\.direction: is none of"),
        ('of = "lift-off"\nname = "x"\nlevel = 1.0', "it has no level"),
        ('of = "lift-off"', "is called 'lift-off', as another.*of its observable"),
        ('level = 1.0\nname = "x"', r"events\[2\]\.of: is missing"),
        ('of = "spin"\nstop = 1', r"events\[2\]\.stop: must be true or false"),
    ],
)
def test_bad_events_are_refused_with_their_place(scene_path, table, says):
    scene_path.write_text(f"{OFF_A_BALL}[[events]]\n{table}\n", encoding="utf-8")
    with pytest.raises(SceneFileError, match=says) as caught:
        load_scene(scene_path)
    (problem,) = caught.value.problems
    assert problem.line > OFF_A_BALL.count("\n")
    assert problem.remedy


def test_a_run_stops_where_the_command_line_says(scene_path):
    done = run("simulate", scene_path, "--stop", "lift-off")
    assert done.exit_code == 0, done.output
    file = load_scene(scene_path)
    alone = rk.simulate(file.scene, file.start, (0.0, 2.6), stop="lift-off")
    # printed to six digits
    assert f"stopped           at {float(alone.final_time):.6g} s" in done.output
    assert "event turned over " in done.output
    assert "event lift-off    1 time at 2.48" in done.output
    missed = run("simulate", scene_path, "--stop", "lift of")
    assert missed.exit_code == 2
    assert "no event 'lift of'; use turned over, lift-off" in missed.output


def test_a_study_watches_what_its_scene_does(scene_path, tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(
        'scene = "off.toml"\n'
        '[vary."body.mass"]\ndistribution = "uniform"\nlow = 0.9\nhigh = 1.1\n'
        '[[events]]\nname = "turned over"\nof = "tilt"\nlevel = 1.0\nstop = true\n',
        encoding="utf-8",
    )
    events = load_study(path).study.events
    assert [event.name for event in events] == ["lift-off", "turned over"]
    assert [event.stop for event in events] == [False, True]
    path.write_text(path.read_text().replace("stop = true", 'stop = "yes"'))
    with pytest.raises(SceneFileError, match=r"events\[0\]\.stop"):
        load_study(path)
