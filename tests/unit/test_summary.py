"""The summary of a run, and where a sampled function changes its sign."""

import numpy as np

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


def test_summary():
    file = load_scene("rattleback")
    times = np.linspace(0, 3, 301)
    text = "\n".join(summary(simulate(file.scene, file.start, times, rtol=1e-10)))
    text = " ".join(text.split())
    for part in (
        "spin +4.99962 ->",
        "reversals 2.7611, 2.7803,",
        "about body axis z reversals",
        "energy drift",
        "accepted,",
        "normal force 1.683 N at least, t = 2.49 s",
        "friction needed 0.7608 at most, t = 0.45 s",
    ):
        assert part in text
    assert "pull" not in text
