"""The live page in a browser: numbers are dragged, and the motion follows."""

import threading

import pytest

from rollkane.cli.live_command import LiveServer
from rollkane.pictures.live_run import LiveRun
from tests.browser.chromium import Browser, command, wait_until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(command() is None, reason="chromium is not installed"),
]


@pytest.fixture(scope="module")
def server():
    found = LiveServer(LiveRun("ball-on-plane"))
    thread = threading.Thread(target=found.serve_forever)
    thread.start()
    yield found
    found.shutdown()
    thread.join()
    found.server_close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    found = Browser(tmp_path_factory.mktemp("live"))
    yield found
    found.close()


def drag(browser, path, value):
    """What a hand on a slider does to the page."""
    browser.run(
        f"(() => {{ const i = rollkane.live.inputs[{path!r}].input; i.value = {value};"
        "i.dispatchEvent(new Event('input')); })()"
    )
    wait_until(lambda: not browser.run("rollkane.live.busy"))
    browser.settle()


def test_a_dragged_number_is_another_motion(browser, server):
    browser.visit(server.address)
    wait_until(lambda: browser.run("'live' in rollkane"))
    last = "rollkane.player.motion.row('position', rollkane.player.motion.count - 1)"
    before, picture = browser.run(last), browser.picture()
    browser.run("rollkane.player.play(false)")
    drag(browser, "start.angular_velocity[1]", 9.0)
    after = browser.run(last)
    assert after != before
    assert abs(browser.picture() - picture).max() > 0.1
    assert "runs in the last second" in browser.run("rollkane.live.told.textContent")
    browser.click("restore")
    wait_until(lambda: not browser.run("rollkane.live.busy"))
    assert browser.run(last) == before
    assert browser.complaints == []
    own = {server.address, f"{server.address}run"}
    assert {x for x in browser.requests if not x.startswith("about:")} == own


def test_a_dragged_surface_is_another_mesh(browser, server):
    browser.visit(server.address)
    wait_until(lambda: browser.run("'live' in rollkane"))
    size = "rollkane.player.size"
    before = browser.run(size)
    drag(browser, "body.surface.radius", 2.0 * before)
    assert browser.run(size) == pytest.approx(2.0 * before, rel=1e-3)
    assert browser.run("rollkane.player.stage.body.children.length") >= 2
    enlarged = browser.picture()
    browser.click("restore")
    wait_until(lambda: not browser.run("rollkane.live.busy"))
    browser.settle()
    assert browser.run(size) == pytest.approx(before, rel=1e-3)
    assert abs(browser.picture() - enlarged).max() > 0.1
    assert browser.complaints == []


def test_what_is_refused_is_told(browser, server):
    browser.visit(server.address)
    wait_until(lambda: browser.run("'live' in rollkane"))
    browser.run("rollkane.live.values['body.mass'] = -1, rollkane.live.ask()")
    wait_until(lambda: not browser.run("rollkane.live.busy"))
    assert "body.mass" in browser.run("rollkane.live.told.textContent")
    assert browser.run("rollkane.live.told.className") == "refused"
