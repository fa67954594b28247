"""What a run would be refused for is told where its scene file is read."""

import pytest

import rollkane as rk
from rollkane.files.scene_files import SceneFileError, load_scene
from rollkane.simulation.known_calls import ReadyCall
from rollkane.simulation.run import check_run

from .test_cli import BALL, rollkane_with

SHAKEN = BALL.replace(
    '[base.surface]\nkind = "sphere"\nradius = 0.5',
    '[base]\nsurface = { kind = "plane" }\n'
    'motion = { kind = "record", file = "short.txt", format = "two-column", '
    'unit = "m/s2", axes = ["x"] }',
).replace("[0.0, 0.0, 0.5]", "[0.0, 0.0, 0.0]")
ROLLING = """
[[rolling]]
on = { kind = "sphere", radius = 0.08, inside = true }
[rolling.body]
mass = 0.1
inertia = [[1e-5, 0, 0], [0, 1e-5, 0], [0, 0, 1e-5]]
surface = { kind = "sphere", radius = 0.02 }
[rolling.start]
contact_on_carrier = [0.0, 0.0, -0.08]
"""
SLIP = BALL.replace("rotations = []", "rotations = []\nslip = [1.0, 0.0, 0.0]")
RING = BALL.replace('kind = "sphere"\nradius = 0.5', 'kind = "ring"\nradius = 0.5')
RING = RING.replace('{ kind = "sphere"', '{ kind = "ring"')
RING = RING.replace("rotations = []", 'rotations = [["x", 40.0]]\nallow_overlap = true')
RING = RING.replace(
    "contact_on_base = [0.0, 0.0, 0.5]",
    "contact_on_base = [0.5, 0.0, 0.0]\nbase_normal = [0.6, 0.0, 0.8]",
)
SPIN = "start.angular_velocity"
TWO = '[[events]]\nof = "spin"\nname = ""\n[[events]]\nof = "tilt"\nname = "event 0"\n'
# text of a file; the field that is told, the problem
REFUSED = {
    "a record shorter than the run": (
        SHAKEN,
        ("run.duration", "must stay within the record of Base.motion", "1.0"),
    ),
    "modes beside bodies that roll on the body": (
        BALL + "[modes]\nfriction = 0.2\n" + ROLLING,
        ("modes", "cannot be used where bodies roll", None),
    ),
    "slip beside modes without friction": (
        SLIP + "[modes]\nrestitution = 0.5\n",
        ("modes.friction", "is missing for a start that slips", None),
    ),
    "an edge that lands on an edge": (
        RING + "[modes]\nrestitution = 0.5\n",
        ("modes.restitution", "cannot land on a Ring", "0.5"),
    ),
    "the name of an event without one": (
        BALL + TWO,
        ("events", "is the name of several events", None),
    ),
    "a duration that rounds away": (
        BALL.replace("duration = 1.0", "duration = 1e-323"),
        ("run.duration", "strictly increasing", "1e-323"),
    ),
}


def written(folder, text):
    samples = "\n".join(f"{k / 10} {k % 3}" for k in range(6))
    (folder / "short.txt").write_text(samples + "\n")
    path = folder / "scene.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_that_cannot_be_run_is_not_good(tmp_path, case):
    text, (field, problem, value) = REFUSED[case]
    path = written(tmp_path, text)
    with pytest.raises(SceneFileError) as caught:
        load_scene(path)
    (found,) = caught.value.problems
    assert found.field == field
    assert problem in found.problem
    assert found.value == value
    assert found.line
    for command in ("check", "simulate"):
        done = rollkane_with(command, str(path))
        assert done.exit_code == 2
        assert f"error: {field}: " in done.output
        assert problem in done.output


def test_check_asks_what_simulate_asks(monkeypatch):
    """Of a good call nothing is run, and of a bad one the same is told."""

    def never(*_):
        raise AssertionError("was run")

    monkeypatch.setattr(ReadyCall, "__call__", never)
    file = load_scene("rolling-disc")
    check_run(file.scene, file.start, file.times, events=("lift-off",))
    for bad in ({"rtol": 1e-20}, {"method": "fast"}, {"modes": 1}, {"events": 3}):
        told = []
        for ask in (check_run, rk.simulate):
            with pytest.raises(rk.FieldError) as caught:
                ask(file.scene, file.start, file.times, **bad)
            told.append(str(caught.value))
        assert told[0] == told[1]


def test_a_duration_of_an_option_is_that_of_the_run(tmp_path):
    """Shorter than the file's, it stays within a record that the file leaves."""
    path = str(written(tmp_path, SHAKEN))
    assert rollkane_with("simulate", path, "-q", "--duration", "0.4").exit_code == 0
    done = rollkane_with("simulate", path, "-q", "--duration", "0.6")
    assert done.exit_code == 2
    assert "run.duration: must stay within the record" in done.output
    assert "got 0.6" in done.output
    varied = ("--vary", "body.mass=1,2", "--duration", "0.4")
    assert rollkane_with("sweep", path, "-q", *varied).exit_code == 0


@pytest.mark.parametrize(
    ("command", "options", "says"),
    [
        (
            "simulate",
            ["--set", "body.mass=1", "--set", "body.mass=2"],
            "body.mass twice",
        ),
        ("simulate", ["--set", "run.duration=1", "--duration", "2"], "--duration sets"),
        ("simulate", ["--set", "run.rtol=1e-6", "--rtol", "1e-9"], "--rtol sets"),
        (
            "simulate",
            ["--set", "start.contact_on_base[0]=0", "--set", "start.contact_on_base=1"],
            "start.contact_on_base would undo start.contact_on_base[0]",
        ),
        (
            "sweep",
            ["--set", "body.mass=5", "--vary", "body.mass=1,2"],
            "varies body.mass, and --set sets body.mass",
        ),
        (
            "sweep",
            ["--set", f"{SPIN}[2]=5", "--vary", f"{SPIN}[02]=1,2"],
            "and --set sets start.angular_velocity[2]",
        ),
        (
            "sweep",
            ["--vary", f"{SPIN}[2]=5,6", "--vary", f"{SPIN}[02]=1,2"],
            "would undo start.angular_velocity[2]",
        ),
        (
            "live",
            ["--no-browser", "--vary", "body.mass=1:2", "--vary", "body.mass=2:3"],
            "names body.mass twice",
        ),
    ],
)
def test_what_is_given_twice_is_refused(tmp_path, command, options, says):
    done = rollkane_with(command, str(written(tmp_path, BALL)), *options)
    assert done.exit_code == 2
    assert says in " ".join(done.output.split())


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ('[modes]\n[[events]]\nof = "spin"\nname = "switch"\n', "switch_time"),
        (
            '[[events]]\nof = "spin"\nname = "a/b"\n'
            '[[events]]\nof = "tilt"\nname = "a_b"\n',
            "a_b_time",
        ),
    ],
)
def test_events_that_no_data_set_tells_apart_are_refused_at_once(
    tmp_path, monkeypatch, more, says
):
    """They were after the run, whose table was lost. A table of CSV has no events."""

    def never(*_):
        raise AssertionError("was run")

    path, out = str(written(tmp_path, BALL + more)), tmp_path / "run.nc"
    with monkeypatch.context() as patched:
        patched.setattr(ReadyCall, "__call__", never)
        done = rollkane_with("simulate", path, "--out", str(out))
    assert done.exit_code == 2
    assert f'would be another "{says}"' in " ".join(done.output.split())
    assert not out.exists()
    table = str(tmp_path / "run.csv")
    assert rollkane_with("simulate", path, "-q", "--out", table).exit_code == 0


def test_changes_in_python_do_not_undo_each_other(tmp_path):
    path = written(tmp_path, BALL)
    whole = {"start.angular_velocity": "[1.0, 2.0, 3.0]"}
    entry = {"start.angular_velocity[0]": "7.0"}
    # turned by nothing: the body's axes are the fixed ones
    found = load_scene(path, whole | entry).start.angular_velocity
    assert found.tolist() == [7.0, 2.0, 3.0]
    with pytest.raises(SceneFileError, match=r"\[0\] is given again by start\.ang"):
        load_scene(path, entry | whole)
    with pytest.raises(SceneFileError, match="is no path of a field"):
        load_scene(path, {".body.mass": "2.0"})


@pytest.mark.parametrize(
    ("path", "value", "lacks"),
    [
        ("body", "{}", "body.mass"),
        ("run", "{}", "run.duration"),
        ("body.surface", '{ kind = "sphere" }', "body.surface.radius"),
    ],
)
def test_a_table_in_the_place_of_the_file_s_may_lack_fields(
    tmp_path, path, value, lacks
):
    """Was: a KeyError for what stood in the file."""
    with pytest.raises(SceneFileError, match=f"{lacks}: is missing"):
        load_scene(written(tmp_path, BALL), {path: value})


@pytest.mark.parametrize("value", ["2", "1.5", '"up"'])
def test_the_directions_of_an_event_are_listed(tmp_path, value):
    event = f'[[events]]\nof = "spin"\ndirection = {value}\n'
    with pytest.raises(SceneFileError) as caught:
        load_scene(written(tmp_path, BALL + event))
    (found,) = caught.value.problems
    assert found.field == "events[0].direction"
    assert found.remedy == "use one of: -1, 0, 1"


def test_steady_tells_that_modes_are_left_out(tmp_path):
    """Of the disc that needs a friction of 0.26 and more, and of one that has it."""
    text = rollkane_with("scenes", "--show", "rolling-disc").output
    hold = ("--hold", "speed=1.5", "--hold", "tilt")
    for friction, ends in ((0.05, True), (5.0, False)):
        path = str(written(tmp_path, f"{text}\n[modes]\nfriction = {friction}\n"))
        done = rollkane_with("steady", path, *hold)
        assert done.exit_code == 0
        assert "[modes] are left out" in done.output
        assert ("with [modes] the motion would slip" in done.output) is ends
        quiet = rollkane_with("steady", path, *hold, "-q")
        assert ("would slip" in quiet.output) is ends
        assert "left out" not in quiet.output
