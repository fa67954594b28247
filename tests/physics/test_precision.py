"""What accuracy costs: errors that are true, and recommendations that hold."""

import itertools
import json

import jax
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import builtin_scenes, load_scene
from rollkane.studies import timing

from .. import problems
from ..quick import slow_but

ASKED = 1e-6
RECORDED = ("isolator", "shaken-plate")


def pose(run):
    """Where a run ended: position, orientation, carried coordinates."""
    last = lambda x: np.asarray(x)[-1]
    return last(run.position), last(run.orientation), last(run.alpha)


def apart(a, b):
    """Largest of distance [m], angle [rad] and carried coordinates, of two ends."""
    turned = abs(float(a[1] @ b[1]))
    angle = 2.0 * np.arccos(min(turned, 1.0))
    if turned > 0.9:  # arccos has no digits there: by the chord
        angle = 4.0 * np.arcsin(
            0.5 * np.linalg.norm(a[1] - np.sign(a[1] @ b[1]) * b[1])
        )
    carried = np.abs(a[2] - b[2])
    return max(np.linalg.norm(a[0] - b[0]), angle, carried.max() if carried.size else 0)


@pytest.fixture(scope="module")
def disc():
    """P2, measured over 5 s."""
    scene, start = problems.disc(6.0 + 1.5 * np.cos(np.deg2rad(70.0)))
    seen = []
    work = rk.work_precision(
        scene,
        start,
        5.0,
        solvers=("Dopri5", "Dopri8"),
        tolerances=(1e-4, 1e-6, 1e-8, 1e-10),
        methods=("native",),
        precisions=("double", "single"),
        repeats=1,
        progress=lambda *told: seen.append(told),
    )
    return scene, start, work, seen


def test_errors_are_true(disc):
    """Each against a run of another method at rtol 1e-13, far below what it had."""
    scene, start, work, _ = disc
    fine = pose(rk.simulate(scene, start, [0.0, 5.0], rtol=1e-13))
    for row in work.rows[:3]:
        options = row.setting.options(5.0)
        found = apart(pose(rk.simulate(scene, start, [0.0, 5.0], **options)), fine)
        # both references are surer than this, twice over
        np.testing.assert_allclose(row.error, found, rtol=1e-2, atol=work.certainty)
        assert row.error == max(row.position_error, row.rotation_error)


def test_errors_fall_with_the_tolerance(disc):
    _, _, work, _ = disc
    double = [row for row in work.rows if row.setting.precision == "double"]
    for solver in ("Dopri5", "Dopri8"):
        rows = [row for row in double if row.setting.solver == solver]
        errors = [row.error for row in rows]
        # errors per unit step: a factor of 100 in rtol, less a factor of 10
        assert all(a > 10 * b for a, b in itertools.pairwise(errors))
        assert all(row.energy_error < 10 * row.error for row in rows)
        stages = 6 if solver == "Dopri5" else 13
        assert all(row.evaluations == 1 + stages * row.steps for row in rows)
    assert work.certainty < 0.1 * min(row.error for row in double)
    single = next(row for row in work.rows if row.setting.precision == "single")
    assert 1e-7 < single.error < 1e-1  # of the tolerance 1e-4, and 24 bits


def test_what_cannot_run_is_told(disc):
    _, _, work, seen = disc
    told = {setting.series: why for setting, why in work.skipped}
    assert told["Dopri5, native, single"] == "tolerances below 2e-06 only add rounding"
    assert seen[0] == (0, 16, "Dopri5, native")
    assert seen[-1][:2] == (16, 16)


def test_json_and_table(disc):
    _, _, work, _ = disc
    read = json.loads(work.to_json())
    assert len(read["rows"]) == len(work.rows) == 10
    assert read["rows"][0]["setting"]["solver"] == "Dopri5"
    assert read["certainty"] == work.certainty
    lines = work.table().splitlines()
    assert len(lines) == 1 + 10 + len(work.skipped)
    assert lines[1].startswith("Dopri5, native")


def test_recommendation_of_measurements(disc):
    _, _, work, _ = disc
    for asked in (1e-3, 1e-6):
        best = work.recommend(asked)
        assert best.error <= asked
        others = [r for r in work.rows if r.error + work.certainty <= asked]
        assert best.seconds == min(row.seconds for row in others)
    with pytest.raises(rk.FieldError, match="is below what is known of this motion"):
        work.recommend(0.1 * work.certainty)
    with pytest.raises(rk.FieldError, match=r"met by no setting.*the best had"):
        work.recommend(2.0 * work.certainty)


def test_picture(disc, tmp_path):
    _, _, work, _ = disc
    target = tmp_path / "work.png"
    work.plot(target)
    assert target.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "name",
    # a dozen programs each; records go by diffrax, whose solvers take 15 s to compile
    slow_but(["euler-disc", "rattleback", "shell-with-pendulum"], builtin_scenes()),
)
def test_recommended_solver_meets_the_asked_error(name):
    """Against the finest run."""
    file = load_scene(name)
    found = rk.recommend(file, error=ASKED, repeats=1)
    assert found.error <= ASKED
    horizon = file.times[-1]
    options = found.setting.options(horizon)
    run = rk.simulate(file.scene, file.start, [0.0, horizon], **options)
    fine = rk.simulate(
        file.scene, file.start, [0.0, horizon], **(options | {"rtol": 1e-13})
    )
    # which leaves it less than a tenth of the error
    assert apart(pose(run), pose(fine)) <= 1.1 * ASKED


REFUSED = {
    "solver": (
        {"solvers": ("Euler8",)},
        "work_precision.solvers: is no solver of diffrax, got 'Euler8'",
    ),
    "method": ({"methods": ("fast",)}, "work_precision.methods: is not known"),
    "horizon": ({"horizon": -1.0}, "work_precision.horizon: must be a positive"),
    "scene": ({"scene": 3}, "work_precision.scene: is no Scene"),
}


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_bad_input_is_refused(case):
    changes, message = case
    scene, start = problems.disc(6.0)
    given = {"scene": scene, "start": start, "horizon": 1.0} | changes
    with pytest.raises(rk.FieldError, match=message):
        rk.work_precision(**given)


def test_the_reference_has_more_than_double_precision(monkeypatch):
    """It is surer than double precision, and within what that is sure of."""
    scene, start = problems.disc(6.0)
    task = timing.Task("disc", scene, start, 5.0)
    fine = timing.reference_of(task)
    assert "in 64 bits" in fine.text
    monkeypatch.setattr(timing, "_EXTENDED", (1e-15,))
    coarse = timing.reference_of(task)
    assert "1e-15 in 64 bits and Dopri5 at 1e-14" in coarse.text
    monkeypatch.setattr(timing, "_EXTENDED_STEPS", 100)
    double = timing.reference_of(task)
    assert "Dopri8" in double.text
    # a hundred roundings of numbers of one; of a step's error at 1e-13, a thousandth
    assert fine.certainty < 1e-14 < 1e-13 < double.certainty
    for other in (coarse, double):
        apart = max(timing._differences(fine.end, other.end))
        assert apart <= other.certainty + fine.certainty


def test_no_reference_no_measurement():
    """A start that cannot be used is told of at once."""
    scene, start = problems.disc(6.0)
    spoilt = jax.tree.map(lambda x: x * np.nan, start)
    with pytest.raises(rk.FieldError, match=r"has no reference: .*the start cannot"):
        rk.work_precision(scene, spoilt, 1.0)
