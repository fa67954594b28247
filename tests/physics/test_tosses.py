"""Real records: tosses of a cube, whose flights show the ratios of its inertia.

Of DAIRLab/contact-nets, BSD 3-Clause: tests/data/contact_nets/LICENSE.
"""

import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rollkane as rk
from rollkane.files.contact_nets import RATE, read_toss
from rollkane.identification.report import whiteness

FOLDER = Path(__file__).parents[1] / "data" / "contact_nets"
NUMBERS = (4, 37, 47, 59)
LENGTH = 16  # samples of the shortest flight: one program serves all
CUBE = 0.37 * (2.0 * 0.0524) ** 2 / 6.0  # [kg m^2], of a homogeneous one


@pytest.fixture(scope="module")
def tosses():
    return [read_toss(FOLDER / f"{number}.pt") for number in NUMBERS]


def test_axes_and_units(tosses):
    """Angular velocity is on body axes; the cube falls at g, within its calibration."""
    for toss in tosses:
        kept = toss.flight
        assert kept.stop - kept.start >= LENGTH
        turned = Rotation.from_quat(toss.orientation[kept][:, [1, 2, 3, 0]])
        between = (turned[:-2].inv() * turned[2:]).as_rotvec() * RATE / 2.0
        own = toss.angular_velocity[kept][1:-1]
        # noise of the orientation, 6e-4 rad in the fits below, over two samples
        assert np.abs(between - own).max() < 5.0 * 6e-4 * RATE / np.sqrt(2.0)
        fall = np.polyfit(toss.time[kept], toss.position[kept], 2)[0] * 2.0
        # the records' own accuracy: markers on a cube, scaled by its nominal width
        np.testing.assert_allclose(fall, [0.0, 0.0, -9.81], atol=0.5)


def test_flights_show_ratios_of_the_inertia(tosses):
    scene = rk.Scene(rk.Body(0.37, CUBE * np.eye(3), rk.Sphere(0.01)))
    starts, records = [], []
    for toss in tosses:
        kept = slice(toss.flight.start, toss.flight.start + LENGTH)
        q, w = toss.orientation[kept.start], toss.angular_velocity[kept.start]
        q = q / np.linalg.norm(q)
        fixed = Rotation.from_quat(q[[1, 2, 3, 0]]).apply(w)
        above = (0.0, 0.0, 1.0)  # nothing is in the way, and gravity turns nothing
        starts.append(rk.release(scene, q, fixed, above, (0.0, 0.0, 1.0)))
        gyro = {"gyro": rk.Gyro(toss.angular_velocity[kept])}
        records.append(rk.Record(toss.time[kept], gyro))
    free = [
        rk.Free("start.angular_velocity"),
        rk.Free("body.inertia", form="diagonal ratios"),
    ]
    found = rk.fit(scene, starts, records, free, modes=rk.Modes(), strategy="single")
    assert found.converged
    assert not found.unseen
    moments = np.diag(found.estimates["body.inertia"])
    errors = np.diag(found.standard_errors["body.inertia"])
    np.testing.assert_allclose(moments.sum(), 3.0 * CUBE, rtol=1e-9)
    # ratios are known to a few per cent, and are those of a cube as well as it is one:
    # markers and their frame are a tenth of its mass at most
    assert (errors < 0.05 * CUBE).all()
    assert (np.abs(moments - CUBE) < 0.1 * CUBE + 3.0 * errors).all()
    for misfits in found.residuals:
        # normal with deviation 1 for white noise: beyond 4 once in 4,000 of such tests
        assert abs(whiteness(misfits["gyro"])) < 4.0


class _Runs:
    """Pickles as a call of something else than a tensor."""

    def __reduce__(self):
        return print, ("run",)


def test_other_files_are_refused(tmp_path, capsys):
    good = (FOLDER / "4.pt").read_bytes()
    for name, content in {
        "text": b"t,wx,wy,wz\n0,1,2,3\n",
        "cut short": good[:-1000],
        "empty": b"",
        "a call": pickle.dumps(_Runs()),
    }.items():
        path = tmp_path / "toss.pt"
        path.write_bytes(content)
        with pytest.raises(rk.FieldError, match="is no toss") as caught:
            read_toss(path)
        assert caught.value.field == "read_toss.path", name
    assert capsys.readouterr().out == ""
    with pytest.raises(FileNotFoundError):
        read_toss(tmp_path / "none.pt")
