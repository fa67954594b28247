"""Films and moving models of a run: what is in them, and how they are refused."""

import importlib.util
import io
import json
import os
import struct
import subprocess
import zlib

import equinox as eqx
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

import rollkane as rk
from rollkane.cli import main
from rollkane.files.scene_files import load_scene
from rollkane.geometry.numpy_rotations import rotated
from rollkane.pictures import film, film_colors, motion_parts, rasterizer
from rollkane.pictures.between_samples import at_times
from rollkane.pictures.film import film_times, frames, write_film
from rollkane.pictures.gltf import write_glb
from rollkane.pictures.mesh import surface_mesh
from rollkane.pictures.motion_samples import reached_samples

RADIUS = 0.1
SINGLE = 2.0**-23  # spacing of single precision at 1


def rolled(times, spin=(0.0, 4.0, 1.0)):
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(RADIUS)))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), spin, (0.0, 0.0, 0.0))
    return rk.simulate(scene, start, times)


@pytest.fixture(scope="module")
def ball():
    return rolled(np.linspace(0.0, 1.0, 21))


@pytest.fixture(scope="module")
def inner():
    """A disc in a hoop, of which a tenth is run."""
    file = load_scene("disc-in-hoop")
    return rk.simulate(file.scene, file.start, np.linspace(0.0, 0.6, 25))


# -- between outputs -------------------------------------------------------------------


def test_outputs_are_themselves(inner):
    motion, rows = reached_samples(inner)
    assert rows.size == 25
    again = at_times(motion, motion.time)
    for name, column in motion.columns.items():
        # one product of quaternions, and sums of what cancels
        np.testing.assert_allclose(again.columns[name], column, rtol=0, atol=1e-12)


def test_between_outputs_it_is_the_motion():
    """Of fourth order in the spacing: the cubic's error, and that of the mean spin."""
    errors = []
    for count in (11, 21):
        coarse, _ = reached_samples(swung(np.linspace(0.0, 1.0, count)))
        times = np.linspace(0.0, 1.0, 4 * (count - 1) + 1)
        fine, _ = reached_samples(swung(times))
        found = at_times(coarse, times)
        errors.append(np.max(np.abs(found.position - fine.position)))
        turned = np.abs(np.sum(found.orientation * fine.orientation, axis=1))
        assert np.min(turned) > 1.0 - 1e-4
    # a_max h^4 / 384 with the fourth derivative of some 0.3 m (2 pi / 1.6 s)^4
    assert errors[0] < 3e-5
    assert errors[1] < errors[0] / 10


def swung(times):
    bowl = rk.Base(rk.Sphere(1.0, inside=True))
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(RADIUS)), bowl)
    start = rk.place(scene, (1, 0, 0, 0), (4.0, 4.0, 1.0), (0.0, 0.0, -1.0))
    return rk.simulate(scene, start, times)


def test_more_than_a_turn_between_two_outputs():
    run = rolled(np.linspace(0.0, 1.0, 3), (0.0, 20.0, 0.0))
    motion, _ = reached_samples(run)
    times = np.linspace(0.0, 1.0, 41)
    found = at_times(motion, times)
    half = 10.0 * times  # rad, about y
    wanted = np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], axis=1)
    np.testing.assert_allclose(
        np.abs(np.sum(found.orientation * wanted, axis=1)), 1.0, rtol=0, atol=1e-12
    )


# -- pictures --------------------------------------------------------------------------


def test_a_triangle_covers_its_pixels_and_hides_what_is_behind():
    camera = rasterizer.Camera(np.zeros(3), np.eye(3), 100.0, 1.0, (40, 60))
    picture = rasterizer.empty(camera, (255, 255, 255))
    corners = np.array([[10.2, 5.3], [50.7, 5.3], [10.2, 35.1]])
    near = np.concatenate([corners, np.full((3, 1), 2.0)], axis=1)
    far = near + np.array([0.0, 0.0, 1.0])
    one = np.array([[0, 1, 2]])
    for seen, color in ((near, (200, 0, 0)), (far, (0, 200, 0))):
        pattern = np.array([[color]])
        rasterizer.draw(picture, seen, one, np.zeros((3, 2)), pattern, np.ones(3))
    red = np.rint(picture.color[..., 0]) == 200
    assert not np.any(
        np.rint(picture.color[..., 1]) == 200
    )  # all of it is behind the other
    y, x = np.mgrid[:40, :60] + 0.5
    inside = (x > 10.2) & (y > 5.3) & ((x - 10.2) / 40.5 + (y - 5.3) / 29.8 < 1)
    assert np.array_equal(red, inside)
    np.testing.assert_allclose(picture.depth[red], 2.0, rtol=1e-6)
    rasterizer.draw(
        picture, near, one, np.zeros((3, 2)), np.array([[[0, 0, 0]]]), np.ones(3), 0.25
    )
    np.testing.assert_allclose(picture.color[red][:, 0], 150.0, rtol=1e-6)  # 1/4 black


def test_a_closed_mesh_is_known():
    up = np.array([[0.0, 0.0, 1.0]])
    for surface, closed in (
        (rk.Sphere(0.1), True),
        (rk.Torus(0.3, 0.1), True),
        (rk.DiscEdge(0.2), True),
        (rk.Cylinder(0.1), False),
        (rk.Graph(lambda x, y: x * y), False),
    ):
        mesh = surface_mesh(surface, 0.1 * up, up, 0.1, (17, 9))
        assert motion_parts.is_closed(mesh) == closed, surface


def test_the_body_is_where_the_motion_has_it(ball):
    """The middle of its pixels, against its centre as the camera sees it."""
    motion, _ = reached_samples(ball)
    size = 200, 150
    times = motion.time[[0, 10, 20]]
    pictures = list(frames(ball.scene, motion, times, size))
    parts = motion_parts.motion_parts(ball.scene, motion, motion)
    view = film._View(motion, parts, (size[1], size[0]))
    places = []
    for k, picture in zip((0, 10, 20), pictures, strict=True):
        camera = view.camera(motion.position[k])
        column, row, _ = camera.seen(motion.position[k][None])[0]
        orange = picture.astype(int)
        # of the body's squares and its first sector; the base is grey, without a hue
        own = np.ptp(orange, axis=-1) > 40
        rows, columns = np.nonzero(own)
        # seen in perspective, a ball is off its centre by its radius over the distance
        assert np.hypot(columns.mean() - column, rows.mean() - row) < 8.0
        assert own.sum() > 200
        places.append(column)
    assert places[2] - places[0] > 20  # it rolls to the right


def test_the_background_is_drawn_once_where_nothing_of_it_moves(ball, monkeypatch):
    motion, _ = reached_samples(ball)
    drawn = []
    whole = film._draw_all

    def counted(picture, camera, seen, k, only):
        drawn.append(only)
        whole(picture, camera, seen, k, only)

    monkeypatch.setattr(film, "_draw_all", counted)
    list(frames(ball.scene, motion, motion.time[:4], (40, 30)))
    assert drawn == ["base", "", "", "", ""]


@pytest.mark.parametrize(
    ("duration", "speed"),
    [(0.05, 0.02), (1.0, 0.5), (2.0, 1.0), (12.0, 1.0), (13.0, 2.0), (59.0, 5.0)],
)
def test_films_are_neither_a_flash_nor_a_day(duration, speed):
    times, found = film_times(np.array([3.0, 3.0 + duration]), 25.0)
    assert found == pytest.approx(speed, rel=1e-12)
    assert (times[0], times[-1]) == (3.0, 3.0 + duration)
    assert 1.99 <= duration / found <= 12.01
    assert len(times) == round(duration / found * 25.0) + 1


def test_an_animated_picture(ball, tmp_path, monkeypatch):
    monkeypatch.setattr(film, "_SIZES", {".gif": (80, 60)})
    write_film(ball, tmp_path / "a.gif", "a ball")
    with Image.open(tmp_path / "a.gif") as film_:
        assert film_.size == (80, 60)
        assert film_.n_frames == len(film_times(ball.time, 50.0 / 3.0)[0])
        assert film_.info["duration"] == 60  # ms
        assert film_.info["loop"] == 0
        first = np.asarray(film_.convert("RGB"), float)
        film_.seek(film_.n_frames - 1)
        last = np.asarray(film_.convert("RGB"), float)
    assert np.abs(last - first).max() > 100


def test_a_video(ball, tmp_path, monkeypatch):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="extra `film`")
    monkeypatch.setattr(film, "_SIZES", {".mp4": (80, 60)})
    write_film(ball, tmp_path / "a.mp4")
    assert (tmp_path / "a.mp4").read_bytes()[4:8] == b"ftyp"
    line = [ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", tmp_path / "a.mp4"]
    line += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(line, capture_output=True, check=True).stdout
    seen = np.frombuffer(raw, np.uint8).reshape(-1, 60, 80, 3).astype(float)
    times, speed = film_times(ball.time, 25.0)
    assert len(seen) == len(times)
    motion, _ = reached_samples(ball)
    drawn = next(frames(ball.scene, motion, times[-1:], (80, 60))).astype(float)
    # what is lost by H.264 at this quality; above the text, which is not drawn there
    assert np.abs(seen[-1] - drawn)[:48].mean() < 8.0
    assert speed == 0.5


def test_a_failing_encoder_is_told(ball, tmp_path, monkeypatch):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="extra `film`")
    monkeypatch.setattr(ffmpeg, "get_ffmpeg_exe", lambda: "false")
    monkeypatch.setattr(film, "_SIZES", {".mp4": (80, 60)})
    with pytest.raises(OSError, match="ffmpeg failed"):
        write_film(ball, tmp_path / "a.mp4")
    assert os.listdir(tmp_path) == []


# -- models ----------------------------------------------------------------------------


class Model:
    """A binary glTF file, read by its specification."""

    def __init__(self, path):
        data = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<II", data, 12)
        assert kind == 0x4E4F534A
        assert size % 4 == 0
        self.tables = json.loads(data[20 : 20 + size])
        rest, kind = struct.unpack_from("<II", data, 20 + size)
        assert kind == 0x004E4942
        self.numbers = data[28 + size :]
        assert len(self.numbers) == rest
        assert (
            rest == self.tables["buffers"][0]["byteLength"] + -rest % 4 or rest % 4 == 0
        )

    def view(self, k):
        view = self.tables["bufferViews"][k]
        assert view["byteOffset"] % 4 == 0
        return self.numbers[view["byteOffset"] :][: view["byteLength"]]

    def array(self, k):
        accessor = self.tables["accessors"][k]
        dtype = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        found = np.frombuffer(self.view(accessor["bufferView"]), dtype)
        found = found.reshape(accessor["count"], width)
        if "min" in accessor:
            np.testing.assert_array_equal(
                found.min(axis=0), np.float32(accessor["min"])
            )
            np.testing.assert_array_equal(
                found.max(axis=0), np.float32(accessor["max"])
            )
        return found.astype(float)

    def node(self, name):
        (k,) = [k for k, n in enumerate(self.tables["nodes"]) if n["name"] == name]
        return k

    def moves(self, name):
        """Times, positions and unit quaternions (scalar first) of a node."""
        (animation,) = self.tables["animations"]
        found = {}
        for channel in animation["channels"]:
            if channel["target"]["node"] == self.node(name):
                sampler = animation["samplers"][channel["sampler"]]
                assert sampler["interpolation"] == "LINEAR"
                time = self.array(sampler["input"])[:, 0]
                found[channel["target"]["path"]] = self.array(sampler["output"])
        return time, found["translation"], np.roll(found["rotation"], 1, axis=1)

    def points(self, name):
        mesh = self.tables["meshes"][self.tables["nodes"][self.node(name)]["mesh"]]
        (primitive,) = mesh["primitives"]
        corners = self.array(primitive["indices"])[:, 0].astype(int)
        points = self.array(primitive["attributes"]["POSITION"])
        normals = self.array(primitive["attributes"]["NORMAL"])
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-6)
        assert len(corners) % 3 == 0
        assert corners.max() < len(points)
        return points


@pytest.fixture(scope="module")
def model(inner, tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "hoop.glb"
    write_glb(inner, path, "a hoop")
    return Model(path)


def test_poses_of_a_model_are_those_of_the_run(model, inner):
    rolling = inner.rolling_body(0)
    for name, place, turn in (
        ("body", inner.position, inner.orientation),
        ("rolling 0", rolling.position, rolling.orientation),
    ):
        time, translation, rotation = model.moves(name)
        at = [int(np.argmin(np.abs(time - t))) for t in np.asarray(inner.time)]
        np.testing.assert_allclose(time[at], inner.time, rtol=0, atol=SINGLE)
        np.testing.assert_allclose(translation[at], place, rtol=0, atol=2 * SINGLE)
        same = np.abs(np.sum(rotation[at] * np.asarray(turn), axis=1))
        np.testing.assert_allclose(same, 1.0, rtol=0, atol=4 * SINGLE)
        # readers go the shorter way from key to key: it is the way of the motion
        steps = np.sum(rotation[1:] * rotation[:-1], axis=1)
        assert np.all(np.diff(time) > 0.0)
        assert np.min(steps) > np.cos(0.5 * 0.6)  # rad: 0.5, and what speeds up


def test_meshes_of_a_model_are_those_of_the_scene(model, inner):
    hoop = model.points("body")
    out = np.hypot(hoop[:, 0], hoop[:, 1])
    np.testing.assert_allclose(
        (out - 0.28) ** 2 + hoop[:, 2] ** 2, 0.02**2, rtol=0, atol=4 * SINGLE
    )
    track = model.points("inside 0")
    np.testing.assert_allclose(
        np.hypot(track[:, 0], track[:, 1]), 0.26, rtol=4 * SINGLE
    )
    touched = np.abs(inner.rolling_body(0).contact_on_carrier[:, 2]).max()
    assert np.abs(track[:, 2]).max() <= max(0.02, touched) * (1 + SINGLE)
    # the contact point lies on the ground
    assert np.abs(model.moves("contact")[1][:, 2]).max() < 1e-6


def test_a_model_stands_upright(model):
    """Its topmost node turns z, up here, into y, up in glTF."""
    tables = model.tables
    (top,) = tables["scenes"][tables["scene"]]["nodes"]
    assert sorted(tables["nodes"][top]["children"]) == list(
        range(len(tables["nodes"]) - 1)
    )
    turn = np.roll(tables["nodes"][top]["rotation"], 1)
    np.testing.assert_allclose(rotated(turn, [0.0, 0.0, 1.0]), [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(rotated(turn, [1.0, 0.0, 0.0]), [1, 0, 0], atol=1e-15)


def test_a_model_is_coloured_like_the_viewer(model):
    tables = model.tables
    for image, material in zip(tables["images"], tables["materials"], strict=True):
        data = model.view(image["bufferView"])
        seen = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
        if material["name"] == "contact":
            assert seen.tolist() == [[list(film_colors.COLORS.contact)]]
        elif material["name"] == "body":
            assert tuple(seen[0, 0]) == film_colors.COLORS.marked[0]
            assert tuple(seen[0, 2]) == film_colors.COLORS.body[0]
            assert tuple(seen[1, 2]) == film_colors.COLORS.body[1]
            assert material["alphaMode"] == "BLEND"  # something is in it
        assert zlib.crc32(data[12:29]) == struct.unpack(">I", data[29:33])[0]


# -- refusals, and the command line ----------------------------------------------------


@pytest.mark.parametrize(
    ("write", "name", "says"),
    [
        (write_film, "a.avi", r"\.gif or \.mp4"),
        (write_film, "a", r"has no ending"),
        (write_glb, "a.gltf", r"\.glb"),
    ],
)
def test_other_endings_are_refused(ball, tmp_path, write, name, says):
    with pytest.raises(rk.FieldError, match=says):
        write(ball, tmp_path / name)
    assert os.listdir(tmp_path) == []


def test_a_run_without_a_state_is_refused(tmp_path):
    run = rolled(np.linspace(0.0, 1.0, 3))
    lost = run.state.orientation * np.nan
    empty = eqx.tree_at(lambda x: x.state.orientation, run, lost)
    for write, name in ((write_film, "a.gif"), (write_glb, "a.glb")):
        with pytest.raises(rk.FieldError, match="holds no state"):
            write(empty, tmp_path / name)


def command(*words):
    line = ["simulate", "ball-on-plane", "-q", "--duration", "0.2", *words]
    return CliRunner().invoke(main, line)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(film, "_SIZES", {".gif": (40, 30), ".mp4": (40, 30)})
    return tmp_path


def test_the_command_line_writes_them(folder):
    done = command("--gif", "a.gif", "--glb", "a.glb")
    assert (done.exit_code, done.output) == (0, "")
    assert (folder / "a.gif").read_bytes().startswith(b"GIF89a")
    assert (folder / "a.glb").read_bytes().startswith(b"glTF")
    again = command("--gif", "a.gif")
    assert again.exit_code == 2
    assert "a.gif is there; give --force to replace it" in again.output
    assert command("--gif", "a.gif", "--force").exit_code == 0


def test_a_missing_extra_is_named(folder, monkeypatch):
    known = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name: None if name == "imageio_ffmpeg" else known(name),
    )
    done = command("--mp4", "a.mp4")
    assert done.exit_code == 2
    said = " ".join(done.output.split())
    assert "needs imageio_ffmpeg, which is not installed" in said
    assert "pip install 'rollkane[film]'" in said
