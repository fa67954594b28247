"""Every result draws itself: a figure, or a file of the kind that its name says."""

from types import SimpleNamespace

import matplotlib.figure
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.pictures.envelopes import draw_curve, envelope
from rollkane.pictures.plot_style import LINES, new_figure
from rollkane.stability.periodic_family import CriticalPeriod
from rollkane.uncertainty.rare_event import Estimate, Level

EIGHT = np.array([-0.2 + 3j, -0.2 - 3j, 0.1 + 0j, -0.4 + 0j])


def of(kind, **fields):
    """A result with these fields; the others play no part in its picture."""
    if hasattr(kind, "_fields"):
        return kind(**dict.fromkeys(kind._fields) | fields)
    found = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(found, name, value)
    return found


def periodic(period):
    return of(
        rk.PeriodicMotion,
        period=period,
        multipliers=np.array([1.2 / period, 0.5 + 0.5j, 0.5 - 0.5j]),
        uncertain=np.full(3, 1e-9),
        expected_multipliers=np.array([1.0, 1.0]),
        measure=lambda name: period,
        held=(),
    )


def steady():
    names = {"turn about z": 2j, "shift x": 0j}
    return of(
        rk.SteadyMotion,
        eigenvalues=EIGHT,
        errors=np.full(4, 0.02),
        zeros=names,
        stable=False,
    )


def lyapunov():
    time = np.linspace(1.0, 64.0, 64)
    growth = time[:, None] * np.array([0.3, 0.0, -0.3])
    return of(
        rk.LyapunovSpectrum,
        values=np.array([0.3, 0.0, -0.3]),
        errors=np.full(3, 0.05),
        time=time,
        growth=growth,
    )


def sobol():
    first = {"end": np.array([[0.5, 0.1], [0.3, 0.6]])}
    wide = {"end": np.stack([first["end"] - 0.1, first["end"] + 0.1])}
    return rk.SobolIndices(
        *(("mass", "spin"), 0.95, 100, {}, first, first, wide, wide, wide, wide)
    )


def active():
    return of(
        rk.ActiveDirections,
        of="end",
        factors=("mass", "spin"),
        eigenvalues=np.array([2.0, 1e-3]),
        eigenvalue_interval=np.array([[1.5, 0.0], [2.5, 2e-3]]),
        activity=np.array([1.9, 0.1]),
    )


def rare():
    levels = [Level(k, 0.1, 0.1 * k, 0.5, 100, 0) for k in (1.0, 2.0, 3.0)]
    return of(
        rk.RareEvent,
        of="tilt [rad]",
        threshold=3.4,
        below=False,
        method="subset simulation",
        subset=Estimate(3e-4, 4e-5),
        importance=None,
        level=0.95,
        levels=tuple(levels),
    )


def kane_run():
    unit = lambda t, q, u: u
    system = SimpleNamespace(unit=unit)
    time = np.linspace(0.0, 1.0, 50)
    values = np.stack([np.sin(9 * time), np.cos(9 * time)], axis=1)
    drawn = {"time": time, "q": values, "u": values, "kinetic_energy": time}
    return SimpleNamespace(system=system, **drawn)


RESULTS = {
    "steady": steady,
    "periodic": lambda: periodic(1.0),
    "periodic family": lambda: of(
        rk.PeriodicFamily,
        vary="period",
        points=(periodic(1.0), periodic(1.4)),
        critical=(CriticalPeriod("one", 1.2, 1.0, periodic(1.2)),),
    ),
    "lyapunov": lyapunov,
    "linear model": lambda: of(rk.LinearModel, A=np.diag([1.0, -2.0])),
    "normal modes": lambda: of(
        rk.NormalModes,
        frequencies=np.array([1.0, 2.0]),
        shapes=np.array([[1.0, -0.2, 0.0], [0.1, 1.0, 0.3]]),
        coordinates=("x", "y", "turn z"),
    ),
    "identifiability": lambda: of(
        rk.Identifiability,
        names=("body.mass", "body.inertia[0]"),
        singular_values=np.array([120.0, 0.0]),
    ),
    "design": lambda: of(
        rk.ExperimentDesign,
        scores=np.array([1.0, -np.inf, 2.0]),
        best=2,
        score=2.5,
    ),
    "sobol": sobol,
    "active directions": active,
    "rare event": rare,
}


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_is_a_figure_or_a_file(name, tmp_path):
    result = RESULTS[name]()
    figure = result.plot(title="of $a$ test")
    assert isinstance(figure, matplotlib.figure.Figure)
    assert all(panel.get_xlabel() or panel.get_xticks().size for panel in figure.axes)
    assert "of $a$ test" in figure.get_suptitle()
    for ending, begin in (("svg", b"<?xml"), ("pdf", b"%PDF"), ("png", b"\x89PNG")):
        assert result.plot(tmp_path / f"a.{ending}") is None
        assert (tmp_path / f"a.{ending}").read_bytes().startswith(begin)
    with pytest.raises(rk.FieldError, match=r"ending \.txt is not known"):
        result.plot(tmp_path / "a.txt")


def test_kane_s_run_is_a_figure():
    figure = kane.KaneTrajectory.plot(kane_run())
    assert [panel.get_ylabel() for panel in figure.axes] == [
        "coordinates",
        "speeds",
        "kinetic energy [J]",
    ]


def test_every_public_result_has_a_picture():
    """Classes of results: those that a function of the public face returns."""
    results = (
        *(rk.Trajectory, rk.Ensemble, rk.Fit, rk.Sensitivity, rk.WorkPrecision),
        *(rk.Branch, rk.SteadyMotion, rk.PeriodicMotion, rk.PeriodicFamily),
        *(rk.LyapunovSpectrum, rk.LinearModel, rk.NormalModes, rk.Identifiability),
        *(rk.ExperimentDesign, rk.MonteCarlo, rk.SobolIndices, rk.ActiveDirections),
        *(rk.RareEvent, kane.KaneTrajectory),
    )
    assert all(callable(getattr(kind, "plot", None)) for kind in results)


def test_eigenvalues_are_where_they_are():
    panel = steady().plot().axes[0]
    points = panel.containers[0].lines[0].get_xydata()
    np.testing.assert_array_equal(points, np.stack([EIGHT.real, EIGHT.imag], axis=1))
    assert panel.get_xlim()[0] < -0.4


def test_lines_are_told_apart_in_grey():
    assert len({str(dashes) for _, dashes in LINES}) == len(LINES)


# -- envelopes -------------------------------------------------------------------------


def rippled(rate):
    """A parabola with a ripple of amplitude one in the second half."""
    time = np.linspace(0.0, 10.0, 8001)
    ripple = np.where(time > 5.0, np.sin(rate * time), 0.0)
    return time, 0.1 * time**2 + ripple


def test_fine_ripples_become_an_envelope():
    time, values = rippled(300.0)
    found = envelope(time, values)
    assert not found.rippled[:99].any()
    assert found.rippled[102:198].all()
    # 2.4 ripples a bin: bounds are the parabola and one, within what that grows in a
    # bin of 0.05 s (0.1) and what the sine lacks between samples 0.375 rad apart (0.02)
    middle = slice(102, 198)
    parabola = 0.1 * found.time[middle] ** 2
    np.testing.assert_allclose(found.high[middle], parabola + 1.0, atol=0.12)
    np.testing.assert_allclose(found.low[middle], parabola - 1.0, atol=0.12)


def test_coarse_ripples_and_smooth_curves_stay_lines():
    for rate in (0.0, 20.0):
        time, values = rippled(rate)
        assert not envelope(time, values).rippled.any()
    panel = new_figure((6.0, 2.0)).add_subplot()
    draw_curve(panel, time, values, "k")
    assert (len(panel.lines), len(panel.collections)) == (1, 0)


def test_what_is_drawn_says_so_once_and_hides_nothing_else():
    time, values = rippled(300.0)
    values[100:200] = np.nan
    panel = new_figure((6.0, 2.0)).add_subplot()
    draw_curve(panel, time, values, "k")
    draw_curve(panel, time, values + 5.0, "b")
    assert len(panel.collections) == 2
    assert [text.get_text() for text in panel.texts] == [
        "shaded: from the least to the greatest of ripples"
    ]
    shown = np.isfinite(panel.lines[0].get_ydata())
    np.testing.assert_array_equal(shown[:4000], np.isfinite(values[:4000]))
    assert shown[4200:].sum() == 0
