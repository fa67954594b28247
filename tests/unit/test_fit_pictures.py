"""Pictures and pages of fits: that they show what was measured and predicted."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.pictures.fit_page import fit_page

COUNT = 21  # samples of each record: their programs are compiled once


def run_of_the_rattleback(spin=-5.0):
    file = load_scene("rattleback")
    start = rk.place(
        file.scene, file.start.orientation, (0.0, 0.0, spin), (0.0, 0.0, 0.0)
    )
    times = np.linspace(0.0, 0.2, COUNT)
    return file.scene, start, rk.simulate(file.scene, start, times)


@pytest.fixture(scope="module")
def several():
    """A fit that stays where it begins, of four records; the first has quaternions."""
    scene, start, run = run_of_the_rattleback()
    rates, turned = (np.array(x) for x in (run.state.angular_velocity, run.orientation))
    gyro = lambda: rk.Gyro(rates + 0.1, sigma=0.1)
    signs = np.where(np.arange(COUNT) % 2, 1.0, -1.0)[:, None]
    missing = turned * signs
    missing[3] = np.nan
    both = {"gyro": gyro(), "orientation": rk.Orientation(missing, sigma=0.01)}
    records = [rk.Record(run.time, c) for c in (both, *3 * [{"gyro": gyro()}])]
    free = rk.Free("start.angular_velocity")
    options = {"strategy": "single", "max_evaluations": 1}
    return rk.fit(scene, [start] * 4, records, free, **options), run, signs


def lines(panel, marks):
    return [line.get_ydata() for line in panel.lines if line.get_linestyle() == marks]


def test_a_figure_of_several_records(several):
    found, run, signs = several
    figure = found.plot(title="stones")
    assert "3 of 4 records" in figure.get_suptitle()
    assert "NOT converged" in figure.get_suptitle()
    shown = [panel for panel in figure.axes if panel.get_visible()]
    # two panels for each channel: two channels, one and one
    assert len(shown) == 8
    (gyro,) = [p for p in shown if p.get_ylabel().startswith("gyro")][:1]
    # samples are a tenth off, so that lines and dots are not the same
    predicted = np.asarray(run.state.angular_velocity)
    # the same run, and a sample less its misfit: of numbers up to 10, two roundings
    np.testing.assert_allclose(lines(gyro, "-"), predicted.T, rtol=0, atol=1e-13)
    dots = lines(gyro, "None")
    np.testing.assert_allclose(dots, predicted.T + 0.1, rtol=0, atol=1e-13)
    (turned,) = [p for p in shown if p.get_ylabel().startswith("orientation")]
    expected = np.asarray(run.orientation) * signs
    expected[3] = np.nan
    # the sign is that of the samples; some ten roundings of numbers below one
    np.testing.assert_allclose(lines(turned, "-"), expected.T, rtol=0, atol=1e-13)


@pytest.mark.parametrize("angle", [1e-3, 0.3, 2.0, 3.1])
def test_a_quaternion_from_the_rotation_that_is_left(angle):
    """Away from the samples, as far as the prediction is: about each axis."""
    unit = np.eye(3)
    measured = np.array([[np.cos(angle / 2), *(np.sin(angle / 2) * u)] for u in unit])
    still = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    channel = rk.Orientation(measured, 0.1)
    away = np.asarray(channel.misfit(jnp.asarray(still)))
    np.testing.assert_allclose(away, 2.0 * np.sin(angle / 2) * unit, rtol=0, atol=1e-15)
    # rounding of a product of unit quaternions, and of a cosine by its sine: the
    # rounding 2e-16 of the square of the sine over twice the cosine, 0.02 or more
    back = channel.without(away)
    np.testing.assert_allclose(back, still, rtol=0, atol=1e-15 + 1e-14)


def test_a_page_of_several_records(several):
    text = fit_page(several[0], "<stones>")
    assert "&lt;stones&gt;" in text
    assert "<stones>" not in text
    for name in several[0].names:
        assert f"<th>{name}</th>" in text
    assert text.count("<td style=") == len(several[0].names) ** 2


def test_files(several, tmp_path):
    several[0].plot(tmp_path / "a.png")
    several[0].write_report(tmp_path / "a.html", "stones")
    with pytest.raises(rk.FieldError, match=r"ending \.txt is not known.* \.html"):
        several[0].write_report(tmp_path / "a.txt")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "a.html").read_text().endswith("</html>\n")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.html", "a.png"]


@pytest.mark.parametrize(
    ("factor", "words"),
    [(180.0 / np.pi, "look like degrees"), (np.pi / 180.0, "turned from degrees")],
)
def test_a_hint_at_units(factor, words):
    scene, start, run = run_of_the_rattleback()
    gyro = rk.Gyro(factor * np.asarray(run.state.angular_velocity), sigma=0.1)
    record = rk.Record(run.time, {"gyro": gyro})
    free = rk.Free("start.angular_velocity")
    with pytest.warns(UserWarning, match=words):
        rk.fit(scene, start, record, free, strategy="single", max_evaluations=1)


def test_progress_is_told():
    scene, start, run = run_of_the_rattleback()
    gyro = rk.Gyro(np.asarray(run.state.angular_velocity) + 0.1, sigma=0.1)
    record = rk.Record(run.time, {"gyro": gyro})
    told = []
    found = rk.fit(
        scene,
        start,
        record,
        rk.Free("start.angular_velocity"),
        strategy="single",
        progress=lambda runs, chi2: told.append((runs, chi2)),
    )
    runs, chi2 = np.array(told).T
    assert np.all(np.diff(runs) > 0)
    assert runs[-1] <= found.rollouts
    # it is evaluated once more, by another program: some 200 sums of squares, rounded
    assert np.min(np.abs(chi2 - found.chi2)) < 200 * 1e-16 * found.chi2
