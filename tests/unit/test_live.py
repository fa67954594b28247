"""The live view: which numbers are dragged, what comes of others, who is answered."""

import http.client
import json
import shutil
import subprocess
import threading

import jax
import numpy as np
import pytest

import rollkane as rk
from rollkane.cli.live_command import LiveServer
from rollkane.files.scene_files import SceneFileError, builtin_scenes, load_scene
from rollkane.pictures import viewer
from rollkane.pictures.live_run import LEAST_RTOL, LiveRun
from tests.unit.test_cli import BALL, rollkane_with
from tests.unit.test_viewer import Page, unpacked

from ..quick import A_FEW, slow_but


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "ball.toml"
    path.write_text(BALL)
    return path


@pytest.fixture(scope="module")
def live(ball):
    return LiveRun(ball)


@pytest.fixture(scope="module")
def server(live):
    found = LiveServer(live)
    thread = threading.Thread(target=found.serve_forever)
    thread.start()
    yield found
    found.shutdown()
    thread.join()
    found.server_close()


def ask(server, method, path, body=None, host=None):
    line = http.client.HTTPConnection(*server.server_address[:2], timeout=60)
    headers = {"Host": host or server.host}
    line.request(method, path, body, headers)
    answer = line.getresponse()
    found = answer.status, answer.read()
    line.close()
    return found


def test_numbers_of_a_file_are_dragged_about_their_values(live):
    found = {one.path: one for one in live.numbers}
    assert {"body.mass", "body.surface.radius", "base.surface.radius"} <= set(found)
    assert found["body.mass"][1:] == (1.0, 1.0 / 3.0, 3.0)
    spin = found["start.angular_velocity[1]"]
    reach = 2 * np.hypot(5.0, 2.0)
    assert spin[1:] == pytest.approx((5.0, -reach, reach))
    assert not any("inertia" in path or "outputs" in path for path in found)


@pytest.mark.parametrize("name", slow_but(A_FEW, builtin_scenes()))
def test_every_built_in_scene_has_numbers_that_it_can_have(name):
    """Each number is one that the scene can be read with."""
    live = LiveRun(name)
    assert "body.mass" in {one.path for one in live.numbers}
    for one in live.numbers:
        assert one.low <= one.value <= one.high, one
        changed = {one.path: repr(one.value)}
        assert rk.Scene is type(read(name, changed, live).scene)


def read(name, changes, live):
    return load_scene(name, changes, live._parts)


def test_a_run_is_that_of_the_file_with_other_numbers(ball, live):
    values = {"body.mass": 1.7, "start.angular_velocity[2]": -3.0}
    run = live.run(values)
    file = read(ball, {path: repr(x) for path, x in values.items()}, live)
    alone = rk.simulate(file.scene, file.start, run.time, rtol=1e-10)
    # by steps of an error of LEAST_RTOL each, of which there are under a hundred
    atol = 100 * LEAST_RTOL
    np.testing.assert_allclose(run.position, alone.position, rtol=0, atol=atol)
    assert run.method == "native"


def test_an_event_of_the_file_ends_the_run(tmp_path):
    """The page shows what simulate gives: here the ball's axis has tilted by 0.5."""
    path = tmp_path / "tilting.toml"
    path.write_text(BALL + '[[events]]\nof = "tilt"\nlevel = 0.5\nstop = true\n')
    run = LiveRun(path).run({})
    assert run.code == rk.Code.STOPPED
    found = run.events["tilt"]
    assert float(found.times[0]) == float(run.final_time)


def test_another_number_compiles_nothing(live):
    live.data({"body.mass": 1.0}, shapes=False)
    compiled = []
    with jax.log_compiles():
        import logging

        class Counter(logging.Handler):
            def emit(self, record):
                compiled.append(record.getMessage())

        counter = Counter()
        logging.getLogger("jax").addHandler(counter)
        try:
            live.data({"body.mass": 1.23}, shapes=False)
        finally:
            logging.getLogger("jax").removeHandler(counter)
    assert not [text for text in compiled if text.startswith("Compiling")]


def test_parts_whose_tables_are_the_same_are_taken_again():
    live = LiveRun("shaken-plate")
    base = live.run({}).scene.base
    other = live.run({"body.mass": live.numbers[0].value * 1.1}).scene
    assert other.base is base
    radius = next(one for one in live.numbers if "surface" in one.path)
    larger = {radius.path: 1.1 * radius.value}
    assert live.changes_shapes(larger, {})
    assert not live.changes_shapes({"body.mass": 3.0}, {})
    # back to the file's, too, and not while another number is dragged
    assert live.changes_shapes({}, larger)
    assert live.changes_shapes({radius.path: radius.value}, larger)
    assert not live.changes_shapes(larger | {"body.mass": 3.0}, larger)


def test_rolling_bodies_are_taken_again_while_their_tables_stay():
    parts = {}
    first = load_scene("shells-in-shells", None, parts)
    (other,) = load_scene(
        "shells-in-shells", {"body.mass": "0.9"}, parts
    ).scene.supported
    assert other is first.scene.supported[0]
    wrong = {"rolling[0].start.contact_on_carrier": "[0.1, 0.0, 0.0]"}
    for _ in range(2):  # what is refused is not kept
        with pytest.raises(SceneFileError, match="contact_on_carrier"):
            load_scene("shells-in-shells", wrong, parts)
    heavier = load_scene("shells-in-shells", {"rolling[1].body.mass": "0.4"}, parts)
    assert heavier.scene.supported[0].supported[0].body.mass == 0.4
    np.testing.assert_array_equal(heavier.start.contact, first.start.contact)


VALLEY = (
    BALL[: BALL.index("[base.")]
    + """
[base]
surface = { kind = "graph", f = "0.02*y**2" }
[start]
rotations = []
contact_on_base = [0.0, 0.0, 0.0]
angular_velocity = [0.0, 1.0, 0.0]
[run]
duration = 1.0
outputs = 21
"""
)


def box(mesh):
    return [mesh["low"], mesh["high"]]


def test_a_base_is_drawn_as_far_as_a_motion_goes(tmp_path):
    """A valley without ends: what is drawn of it is enough, or comes anew."""
    path = tmp_path / "valley.toml"
    path.write_text(VALLEY)
    live = LiveRun(path)
    first = live.data({})
    drawn = [box(first["base"]), box(first["body"])]
    spin = "start.angular_velocity[1]"
    for rate, renewed in ((1.1, False), (-9.0, True), (9.0, True)):
        values = {spin: rate}
        assert not live.changes_shapes(values, {})
        data = live.data(values, False, drawn)
        assert ("base" in data) == renewed
        low, high = np.array(box(data["base"]) if renewed else drawn[0])[:, :2]
        touched = unpacked(data["frames"]["contact_on_base"])[:, :2]
        assert (low < touched).all()
        assert (touched < high).all()
    # a body that is closed is never left
    assert "body" not in live.data({spin: 9.0}, False, [None, drawn[1]])


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
@pytest.mark.parametrize(("far", "radius"), [(1.9, 3.0), (-2.1, 4.2)])
def test_a_plane_is_laid_as_far_as_a_motion_goes(far, radius):
    """It fades out from about half of its radius, which two thirds of it still show."""
    program = "".join(map(viewer._asset, ("motion.js", "stage.js"))) + (
        f"const motion = {{ count: 2, row: (_, k) => [1 + k * {far}, 0.5, 0] }};"
        "const part = { dispose() {} };"
        "const material = { ...part, map: part, alphaMap: part };"
        "const stage = {"
        "  laid: { center: [1, 0.5], radius: 3 }, base: { remove() {} },"
        "  ground: { geometry: part, material },"
        "  lay(laid) { this.laid = laid; },"
        "};"
        "rollkane.Stage.prototype.reach.call(stage, motion);"
        "console.log(stage.laid.radius);"
    )
    done = subprocess.run(
        ["node", "-"], input=program, capture_output=True, text=True, check=True
    )
    assert float(done.stdout) == pytest.approx(radius, rel=1e-15)


def test_ranges_are_chosen_and_checked(ball):
    live = LiveRun(ball, {"body.mass": (1.0, 2.0)})
    assert [one[:] for one in live.numbers] == [("body.mass", 1.0, 1.0, 2.0)]
    with pytest.raises(rk.FieldError, match="is no number of the file"):
        LiveRun(ball, {"body.colour": (0.0, 1.0)})
    with pytest.raises(rk.FieldError, match="is no range"):
        LiveRun(ball, {"body.mass": (2.0, 1.0)})
    with pytest.raises(rk.FieldError, match="is no number that is dragged"):
        live.run({"body.surface.radius": 0.2})


def test_the_page_may_ask_its_server_and_nobody_else(server, live):
    status, text = ask(server, "GET", f"/{server.key}/")
    assert status == 200
    page = Page(text.decode())
    (policy,) = [
        x for _, name, x in page.attributes if name == "content" and "src" in x
    ]
    assert policy.endswith("img-src data: blob:; connect-src 'self'")
    assert [one["path"] for one in page.data["numbers"]] == [
        one.path for one in live.numbers
    ]


def test_a_question_is_answered_by_the_motion(server, live):
    question = json.dumps({"values": {"body.mass": 2.0}, "shown": {}})
    status, text = ask(server, "POST", f"/{server.key}/run", question)
    assert status == 200
    data = json.loads(text)
    assert "body" not in data  # the surfaces are the same
    position = unpacked(data["frames"]["position"])
    expected = np.asarray(live.run({"body.mass": 2.0}).position)
    np.testing.assert_allclose(position, expected, rtol=1e-6, atol=1e-7)  # float32
    larger = {"body.surface.radius": 0.2}
    radius = json.dumps({"values": larger, "shown": {}})
    data = json.loads(ask(server, "POST", f"/{server.key}/run", radius)[1])
    assert data["size"] == pytest.approx(0.2, rel=1e-3)
    restored = json.dumps({"values": {}, "shown": larger})
    data = json.loads(ask(server, "POST", f"/{server.key}/run", restored)[1])
    assert "body" in data  # the file's surfaces, again


@pytest.mark.parametrize(
    ("question", "says"),
    [
        ('{"values": {"body.mass": -1}, "shown": {}}', "body.mass"),
        (
            '{"values": {"body.colour": 1}, "shown": {}}',
            "is no number that is dragged",
        ),
    ],
)
def test_what_cannot_be_run_is_told(server, question, says):
    status, text = ask(server, "POST", f"/{server.key}/run", question)
    assert status == 200
    assert says in json.loads(text)["refused"]


NOTHING = '{"values": {}, "shown": {}, "drawn": %s}'
MALFORMED = {
    '{"body.mass": 2}': "values is no object of numbers by path",
    '{"values":[],"shown":[]}': "values is no object of numbers by path",
    '{"values": {}, "shown": {"body.mass": "2"}}': "shown of 'body.mass' is no finite",
    '{"values": {"body.mass": %s}, "shown": {}}' % ("9" * 400): "is no finite number",
    '{"values": {"body.mass": NaN}, "shown": {}}': "is no finite number",
    '{"values": {"body.mass": true}, "shown": {}}': "is no finite number",
    NOTHING % "3": "drawn is no list of boxes",
    NOTHING % "[[[0, 0, 0]]]": "is not two corners of three numbers",
    NOTHING % '[null, [[0, 0, 0], [1, 1, "x"]]]': "a box in drawn is no finite number",
    "[1]": "no object with values and shown",
    "nonsense": "Expecting value",
    "9" * 5000: "no JSON",
    "[" * 50_000: "nested too deeply",
    "": "the question is empty",
}


@pytest.mark.parametrize("question", MALFORMED, ids=lambda text: text[:45])
def test_malformed_questions_are_answered(server, question):
    """By one sentence, and the connection goes on."""
    line = http.client.HTTPConnection(*server.server_address[:2], timeout=60)
    path, headers = f"/{server.key}/run", {"Host": server.host}
    line.request("POST", path, question, headers)
    kept = line.sock
    answer = line.getresponse()
    told = json.loads(answer.read())["refused"]
    assert answer.status == 400
    assert MALFORMED[question] in told
    assert "\n" not in told
    line.request("GET", f"/{server.key}/other", headers=headers)
    assert line.getresponse().status == 404
    assert line.sock is kept
    line.close()


@pytest.mark.parametrize("length", ["abc", "-5", "1.5", "9" * 5000])
def test_lengths_that_are_none(server, length):
    line = http.client.HTTPConnection(*server.server_address[:2], timeout=60)
    headers = {"Host": server.host, "Content-Length": length}
    line.request("POST", f"/{server.key}/run", "{}", headers)
    answer = line.getresponse()
    assert answer.status == 400
    assert "Content-Length" in json.loads(answer.read())["refused"]
    assert answer.getheader("Connection") == "close"
    line.close()


def test_what_is_too_long_is_no_question_afterwards(server):
    line = http.client.HTTPConnection(*server.server_address[:2], timeout=60)
    headers = {"Host": server.host}
    question = " " * 100_001 + json.dumps({"values": {}, "shown": {}})
    for size, status in ((question, 413), (question[100_001:], 200)):
        line.request("POST", f"/{server.key}/run", size, headers)
        answer = line.getresponse()
        answer.read()
        assert answer.status == status
    line.close()


def test_strangers_are_not_answered(server):
    """Other addresses, another name of this machine (of other pages), and floods."""
    assert ask(server, "GET", "/")[0] == 404
    assert ask(server, "POST", "/guess/run", "{}")[0] == 404
    assert ask(server, "GET", f"/{server.key}/", host="evil.example")[0] == 404
    assert ask(server, "POST", f"/{server.key}/run", "x" * 100_001)[0] == 413
    assert server.server_address[0] == "127.0.0.1"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["no-such-scene"], "no such file or built-in scene"),
        (["rattleback", "--vary", "body.mass"], "is not PATH=LOW:HIGH"),
        (["rattleback", "--vary", "body.mass=a:b"], "the ends are not numbers"),
        (["rattleback", "--vary", "body.mass=2:1"], "is no range"),
    ],
)
def test_the_command_refuses(options, says):
    done = rollkane_with("live", *options)
    assert done.exit_code == 2
    assert says in done.output


def test_numbers_that_no_scene_can_have_are_refused(live):
    with pytest.raises(SceneFileError, match=r"body\.mass"):
        live.run({"body.mass": -1.0})
