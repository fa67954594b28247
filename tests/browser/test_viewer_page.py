"""The viewer's page in a browser: what it shows, and that all of its controls work."""

import json

import numpy as np
import pytest

import rollkane as rk
from rollkane.pictures.viewer import write_view
from tests.browser.chromium import Browser, command, wait_until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(command() is None, reason="chromium is not installed"),
]

BODY, BASE = 0.1, 0.0
FRAMES = 61


def rolled(axis=(0.0, 4.0, 1.0), **options):
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(BODY)))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), axis, (0.0, 0.0, 0.0))
    return rk.simulate(scene, start, np.linspace(0.0, 1.0, FRAMES), **options)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pages")


@pytest.fixture(scope="module")
def page(folder):
    """A ball that rolls, an event on its way, and two others as ghosts."""
    half = rk.Event(lambda scene, t, state: t - 0.5, name="half way")
    ghosts = [rolled((0.0, speed, 1.0)) for speed in (3.0, 5.0)]
    write_view(rolled(events=(half,)), folder / "ball.html", "A ball", ghosts)
    return folder / "ball.html"


@pytest.fixture(scope="module")
def browser(folder):
    found = Browser(folder)
    yield found
    found.close()


@pytest.fixture
def shown(browser, page):
    """The page at rest at its frame 20; at the end nothing may have been fetched."""
    browser.open(page, "#frame=20")
    yield browser
    assert not foreign(browser, page)
    assert browser.complaints == []


def foreign(browser, page):
    """What was asked for beside the page itself, and files that it made."""
    own = {"about:blank", page.resolve().as_uri()}
    return [x for x in browser.requests if x not in own and not x.startswith("blob:")]


def frame(browser):
    return browser.run("rollkane.player.motion.locate(rollkane.player.elapsed).low")


def red(picture):
    """Pixels of the contact point's colour, #d11f2f, which is seen through the body."""
    r, g, b = np.moveaxis(picture, -1, 0)
    return (r > 0.6) & (g < 0.45) & (b < 0.45) & (r - g > 0.35)


def test_nothing_is_fetched_and_nothing_complains(browser, page):
    browser.open(page)
    browser.settle()
    assert not foreign(browser, page)
    assert browser.complaints == []
    fetched = "performance.getEntriesByType('resource').length"
    assert browser.run(fetched) == 0


def test_arrow_keys_work_after_any_control_was_used(shown):
    for name in ("reset", "traces", "force", "slider", "screenshot", "play", "play"):
        shown.click(name)
        shown.run("rollkane.player.jumpToFrame(20)")
        shown.press("ArrowRight")
        assert frame(shown) == 21, name
        shown.press("ArrowLeft")
        shown.press("ArrowLeft")
        assert frame(shown) == 19, name


def test_the_space_bar_plays_once_also_on_the_play_button(shown):
    playing = "rollkane.player.playing"
    shown.press(" ")
    assert shown.run(playing)
    shown.press(" ")
    assert not shown.run(playing)
    shown.click("play")
    assert shown.run(playing)
    shown.press(" ")  # the button's own key: pressed, and that once
    assert not shown.run(playing)


def test_playing_ends_at_the_last_frame(shown):
    shown.run("document.getElementById('speed').selectedIndex = 9")
    shown.click("play")
    wait_until(lambda: not shown.run("rollkane.player.playing"))
    assert frame(shown) == FRAMES - 2  # the interval whose end is the last
    assert float(shown.run("document.getElementById('time').textContent")) == 1.0


@pytest.mark.parametrize("number", [0, 20, 55])
def test_the_body_touches_the_base_in_the_picture(shown, number):
    """Seen along the ground: its silhouette's lowest row is the contact point's."""
    shown.run(
        f"(() => {{ const p = rollkane.player; p.jumpToFrame({number});"
        "const [x, y, z] = p.stage.body.position.toArray();"
        "p.controls.minDistance = 0; p.controls.target.set(x, y, z);"
        "p.camera.position.set(x, y - 1.0, z); p.controls.update();"
        "p.stage.base.visible = p.stage.ghosts.group.visible = false;"
        "p.stage.onBody.group.visible = false; p.ask(); })()"
    )
    shown.settle()
    lowest = shown.run(
        "(() => { const p = rollkane.player; const s = p.motion.state(p.elapsed);"
        "const v = new THREE.Vector3(...s.contact_on_base).project(p.camera);"
        "const box = p.renderer.domElement.getBoundingClientRect();"
        "return box.y + (0.5 - 0.5 * v.y) * box.height; })()"
    )
    picture = shown.picture()
    stage = shown.run("document.getElementById('bottom').getBoundingClientRect().y")
    # the body's checks are orange, cream and blue on a grey that has no hue
    spread = np.ptp(picture[: int(stage), 300:], axis=-1)
    rows = np.flatnonzero((spread > 0.15).sum(axis=1) > 3)
    # A circle of radius 80 px or more is over 3 px wide one pixel above its end, which
    # falls between two rows; seen from ten radii away, the silhouette ends half of a
    # hundredth of the radius below the contact point: 0.5 px.
    assert abs(rows.max() + 1 - lowest) <= 2.0
    assert rows.max() - rows.min() > 100


@pytest.mark.parametrize("number", [0, 30, 60])
def test_the_contact_point_is_where_the_motion_has_it(shown, number):
    shown.run(f"rollkane.player.jumpToFrame({number})")
    shown.settle()
    x, y = shown.run(
        "(() => { const p = rollkane.player; const s = p.motion.state(p.elapsed);"
        "const v = new THREE.Vector3(...s.contact_on_base).project(p.camera);"
        "const box = p.renderer.domElement.getBoundingClientRect();"
        "return [box.x + (0.5 + 0.5 * v.x) * box.width,"
        " box.y + (0.5 - 0.5 * v.y) * box.height]; })()"
    )
    found = red(shown.picture())
    rows, columns = np.nonzero(found[int(y) - 8 : int(y) + 9, int(x) - 8 : int(x) + 9])
    # a ball of radius 3 px, seen through the body: 28 pixels, less its edge
    assert rows.size > 8
    middle = int(x) - 8 + columns.mean() + 0.5, int(y) - 8 + rows.mean() + 0.5
    assert np.hypot(middle[0] - x, middle[1] - y) < 1.5  # pixels are whole, edges blend


@pytest.mark.parametrize("size", [(360, 640), (600, 500), (800, 600), (1400, 800)])
def test_the_panel_leaves_the_body_free(shown, size):
    """No corner of the body is behind the panel, in windows narrow and wide."""
    shown.resize(size)
    shown.run("rollkane.player.look()")
    shown.settle()
    covered = shown.run(
        "(() => { const p = rollkane.player;"
        "const panel = document.getElementById('panel').getBoundingClientRect();"
        "const box = p.renderer.domElement.getBoundingClientRect();"
        "const at = p.stage.body.position;"
        "return [[1,0,0],[-1,0,0],[0,1,0],[0,-1,0],[0,0,1],[0,0,-1]].filter((d) => {"
        f"  const v = new THREE.Vector3(...d).multiplyScalar({BODY}).add(at)"
        "    .project(p.camera);"
        "  const x = box.x + (0.5 + 0.5 * v.x) * box.width;"
        "  const y = box.y + (0.5 - 0.5 * v.y) * box.height;"
        "  return x < panel.right && x > panel.left"
        "    && y < panel.bottom && y > panel.top"
        "    || x < 0 || x > innerWidth || y < box.y || y > box.y + box.height;"
        "}).length; })()"
    )
    assert covered == 0


def test_no_arrow_leaves_the_picture(shown):
    """Not even far into it; what was cut, and the scale, is told."""
    for name in ("force", "gravity", "omega", "axes"):
        shown.click(name)
    ends = (
        "rollkane.player.stage.arrows.labels(rollkane.player.camera)"
        ".map(({ x, y }) => Math.max(Math.abs(x), Math.abs(y)))"
    )
    assert len(shown.run(ends)) == 9
    assert max(shown.run(ends)) < 1.0
    told = "document.getElementById('force-told').textContent"
    assert shown.run(told).startswith("force 9.81 N (arrow: 0.1 m for ")
    shown.run(
        "(() => { const p = rollkane.player; const c = p.stage.contact.position;"
        "p.controls.minDistance = 0; p.controls.target.copy(c);"
        "p.camera.position.set(c.x, c.y - 0.1, c.z + 0.02); p.controls.update(); })()"
    )
    shown.settle()
    assert shown.run(ends)[0] < 1.0
    assert "cut at the edge" in shown.run(told)
    # of a ball of 1 kg on the level the force is its weight: g and F are told alike
    assert "gravity 9.81 m/s²" in shown.run(
        "document.getElementById('gravity-told').textContent"
    )


def test_the_graph_is_linked_to_the_clock(shown):
    x, y, width = shown.run(
        "(() => { const b = document.getElementById('timeline')"
        ".getBoundingClientRect();"
        "const a = rollkane.player.timeline.area;"
        "return [b.x + a.left, b.y + 0.5 * b.height, a.right - a.left]; })()"
    )
    press = {"x": x + 0.75 * width, "y": y, "button": "left", "clickCount": 1}
    shown.ask("Input.dispatchMouseEvent", type="mousePressed", **press)
    shown.ask("Input.dispatchMouseEvent", type="mouseReleased", **press)
    # a click is a whole pixel of the graph's some hundred
    assert shown.run("rollkane.player.elapsed") == pytest.approx(0.75, abs=1.5 / width)
    names = shown.run(
        "Array.from(document.getElementById('quantity').options, (o) => o.value)"
    )
    assert {"spin", "energy", "position", "contact_force", "orientation"} <= set(names)
    before = shown.picture()
    shown.run(
        "(() => { const q = document.getElementById('quantity'); q.value = 'position';"
        "q.dispatchEvent(new Event('change')); })()"
    )
    shown.settle()
    top = int(y) - 40
    assert np.abs(shown.picture()[top:] - before[top:]).max() > 0.3
    events = shown.run("rollkane.player.timeline.happenings")
    assert events == [{"name": "half way", "time": pytest.approx(0.5, abs=1e-12)}]


def test_ghosts_are_the_other_motions(shown):
    x = shown.run(
        "rollkane.player.jumpToFrame(60), "
        "rollkane.player.stage.ghosts.group.children.map((g) => g.position.x)"
    )
    # an even roll: the centre goes BODY times its rate about y in a second; single
    # precision
    np.testing.assert_allclose(x, [3.0 * BODY, 5.0 * BODY], rtol=1e-6)
    with_them = shown.picture()
    shown.click("ghosts")
    assert np.abs(shown.picture() - with_them).max() > 0.05


def test_a_picture_is_a_file(shown):
    from matplotlib.image import imread

    shown.click("screenshot")
    path = shown.downloaded(".png")
    assert path.name == "a-ball.png"
    picture = imread(path)
    assert picture.shape[:2] == tuple(
        shown.run(
            "(() => { const c = rollkane.player.renderer.domElement;"
            "return [c.height, c.width]; })()"
        )
    )
    assert np.ptp(picture[..., :3]) > 0.5
    assert picture[..., 3].min() == 1.0  # with a background


def test_a_video_is_a_file_that_plays(shown, page):
    shown.run("document.getElementById('speed').selectedIndex = 7")
    shown.click("video")
    assert shown.run("rollkane.player.recorder.recorder !== null")
    path = shown.downloaded(".webm")
    assert path.name == "a-ball.webm"
    assert path.read_bytes()[:4] == b"\x1a\x45\xdf\xa3"  # EBML, of which WebM is one
    assert path.stat().st_size > 5_000
    assert not shown.run("rollkane.player.playing")


def test_changes_of_contact_are_on_the_time_line(browser, folder):
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(BODY)))
    start = rk.place(
        rk.Scene(scene.body, contact=rk.Slipping()),
        *((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
        slip=(1.0, 0.0, 0.0),
    )
    run = rk.simulate(
        scene, start, np.linspace(0.0, 1.0, 101), modes=rk.Modes(friction=0.3)
    )
    write_view(run, folder / "grips.html", "It grips")
    browser.open(folder / "grips.html", "#frame=0")
    contact = "document.getElementById('mode').textContent"
    assert browser.run(contact) == "slips"
    browser.run("rollkane.player.jumpToFrame(100)")
    assert browser.run(contact) == "rolls"
    modes = browser.run("Array.from(rollkane.player.motion.columns.mode)")
    # with a moment of inertia 2/5 m r^2 it grips after 2/7 v / (mu g) = 0.097 s
    assert [modes[5], modes[15]] == [1, 0]
    assert browser.complaints == []
    assert json.dumps(browser.run("rollkane.player.timeline.matters")) == "true"


def test_a_bowl_has_lines_at_round_distances(browser, folder):
    """Seen from above: dark where x or y is a multiple of what the panel tells."""
    scene = rk.Scene(
        rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(BODY)),
        rk.Base(rk.Sphere(1.0, inside=True)),
    )
    start = rk.place(scene, (1, 0, 0, 0), (4.0, 4.0, 1.0), (0.0, 0.0, -1.0))
    run = rk.simulate(scene, start, np.linspace(0.0, 1.0, 61))
    write_view(run, folder / "bowl.html", "A bowl")
    browser.open(folder / "bowl.html", "#frame=0&traces=0")
    spacing = browser.run("rollkane.player.stage.spacing")
    told = browser.run(
        "[document.getElementById('grid'), document.getElementById('grid-unit')]"
        ".map((e) => e.textContent).concat(document.getElementById('grid-row').hidden)"
    )
    assert told == [f"{1000 * spacing:g}", "mm", False]
    places = [(0.1, y) for y in (0.0, 0.05)] + [(0.15, y) for y in (0.0, 0.05)]
    places = [(spacing * x / 0.1, spacing * y / 0.1) for x, y in places]
    pixels = browser.run(
        "(() => { const p = rollkane.player; p.stage.body.visible = false;"
        "p.stage.contact.visible = false; p.controls.minDistance = 0;"
        "p.controls.target.set(0, 0, -1); p.camera.position.set(0, -1e-3, 0.2);"
        "p.controls.update(); p.camera.updateMatrixWorld(); p.ask();"
        f"return {json.dumps(places)}.map(([x, y]) => {{"
        "const v = new THREE.Vector3(x, y, -Math.sqrt(1 - x * x - y * y))"
        ".project(p.camera); const box = p.renderer.domElement.getBoundingClientRect();"
        "return [box.x + (0.5 + 0.5 * v.x) * box.width,"
        " box.y + (0.5 - 0.5 * v.y) * box.height]; }); })()"
    )
    browser.settle()
    picture = browser.picture().mean(axis=-1)
    # the darkest of nine pixels: a line is a pixel wide or two, and they are whole
    seen = [
        picture[int(y) - 1 : int(y) + 2, int(x) - 1 : int(x) + 2].min()
        for x, y in pixels
    ]
    on_both, on_first, on_second, on_none = seen
    assert max(on_both, on_first, on_second) < on_none - 0.05, seen
    assert browser.complaints == []
