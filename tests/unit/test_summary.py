"""The summary of a run, and where a sampled function changes its sign."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rollkane.files.scene_files import load_scene
from rollkane.pictures.summary import sign_changes, summary
from rollkane.simulation.run import simulate


def test_sign_changes_of_a_cubic_are_exact():
    roots = np.array([0.3, 1.55, 1.6])  # the last two between the same samples
    cubic = np.poly(roots)
    time = np.array([0.0, 1.0, 2.0, 3.0])
    found = sign_changes(
        time, np.polyval(cubic, time), np.polyval(np.polyder(cubic), time)
    )
    np.testing.assert_allclose(found, roots, atol=1e-12)


def test_sign_changes_converge_with_the_fourth_power_of_the_spacing():
    errors = []
    for count in (21, 41):
        time = np.linspace(0, 10, count)
        found = sign_changes(time, np.cos(time), -np.sin(time))
        errors.append(np.max(np.abs(found - np.pi * np.array([0.5, 1.5, 2.5]))))
    assert errors[0] < 2e-4  # h^4/384 of a unit cosine, h = 0.5
    assert errors[1] < errors[0] / 10


def test_a_touch_and_a_sample_at_zero():
    time = np.array([0.0, 1.0, 2.0])
    assert sign_changes(time, (time - 1) ** 2, 2 * (time - 1)).size == 0
    np.testing.assert_array_equal(sign_changes(time, time - 1, np.ones(3)), [1.0])
    assert sign_changes(time, np.zeros(3), np.zeros(3)).size == 0
    # nothing changes its sign before the first or after the last sample
    assert sign_changes(time, time, np.ones(3)).size == 0
    assert sign_changes(time, time - 2, np.ones(3)).size == 0


def listed(text: str, pattern: str) -> list[float]:
    """Numbers of the first match of a pattern."""
    found = re.search(pattern, text)
    assert found, (pattern, text)
    return [float(x) for x in re.split(r",? +", found[1].strip())]


def test_summary():
    """What is told of the stone, against differences of the positions of its run."""
    file = load_scene("rattleback")
    step = 1e-4  # [s]: two reversals are 0.3 ms apart
    run = simulate(file.scene, file.start, np.arange(30001) * step, rtol=1e-10)
    text = " ".join("\n".join(summary(run)).split())
    time, spin = np.asarray(run.time), np.asarray(run.angular_velocity)[:, 2]
    (turns,) = np.nonzero(spin[:-1] * spin[1:] < 0)
    # linear between samples: off by step^2 w'' / (8 w'), where w'' / w' is 2 / (0.3 ms)
    # between two so near; and rounded to 1e-4 s
    when = time[turns] - spin[turns] * step / (spin[turns + 1] - spin[turns])
    told = listed(text, r"about the normal reversals ([\d., ]+) s")
    np.testing.assert_allclose(told, when, rtol=0, atol=step**2 / 1.2e-3 + 5e-5)
    ends = re.search(r"spin (\S+) -> (\S+) rad/s about the normal", text)
    assert ends
    told = [float(end) for end in ends.groups()]
    np.testing.assert_allclose(told, spin[[0, -1]], rtol=1e-5)
    # the force by second differences over 1 ms, of a mass centre that rocks at less
    # than 120 rad/s with up to 10 m/s^2: off by (w h)^2 / 12 of it
    body, gravity = file.scene.body, np.array([0.0, 0.0, 9.81])
    turned = Rotation.from_quat(np.asarray(run.orientation)[::10, [1, 2, 3, 0]])
    arm = turned.apply(np.array(body.center_of_mass))
    step, mass, centre = 10 * step, float(body.mass), run.position[::10] + arm
    acceleration = np.diff(centre, n=2, axis=0) / step**2
    force = mass * (acceleration + gravity)
    off = mass * 10.0 * (120.0 * step) ** 2 / 12
    (least,) = listed(text, r"normal force ([\d.]+) N at least")
    assert abs(least - force[:, 2].min()) < off + 5e-4
    needed = np.linalg.norm(force[:, :2], axis=1) / force[:, 2]
    (most,) = listed(text, r"friction needed ([\d.]+) at most")
    assert abs(most - needed.max()) < 2 * off / force[needed.argmax(), 2] + 5e-5
    (drift,) = listed(text, r"energy drift ([\de.+-]+)")
    energy = np.asarray(run.energy)
    assert drift == pytest.approx(np.abs(energy / energy[0] - 1).max(), rel=0.05)
    counts = listed(text, r"steps (\d+) accepted"), listed(text, r"(\d+) rejected")
    assert counts == ([int(run.steps)], [int(run.rejected_steps)])
    assert "about body axis z reversals" in text
    assert "pull" not in text
