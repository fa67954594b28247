"""What passes along a family of periodic motions, by Hill's equation and quadrature.

A homogeneous ball rolls on a plane with 7/5 of its mass under the forces of a
potential: what is written here for 1 kg is the potential of y'' and x'' over 0.7.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq, minimize_scalar
from scipy.special import mathieu_a, mathieu_b

import rollkane as rk
from rollkane.stability.branch_segments import Segment
from rollkane.stability.critical_points import bisected, critical_on

BALL = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
UPRIGHT, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
G, HEIGHT = 9.81, 0.1
ZERO = dict.fromkeys(("d", "e", "c", "four", "six", "k", "X", "Y"), 0.0)


def valley(p, q):
    """Along x, with a detent of strength k, 0.03 m wide, that begins at y = 1."""
    x, y = p[0] - q["X"], p[1] - q["Y"]
    stiff = q["d"] + q["e"] * y + q["c"] * y**2
    bottom = y**2 + q["four"] * y**4 - q["six"] * y**6
    detent = jnp.exp(-(((y - 1.0) / 0.03) ** 2) - (x / 0.5) ** 2)
    return 0.7 * (bottom + stiff * x**2) + q["k"] * detent


def swing(far, period=2.0 * np.pi, **numbers):
    """Across it, by an amplitude."""
    numbers = ZERO | numbers
    potential = rk.Potential(valley, parameters=numbers)
    scene = rk.Scene(BALL, loads=(rk.Gravity(), potential))
    place = numbers["X"], numbers["Y"] + far, 0.0
    start = rk.place(scene, UPRIGHT, STILL, place)
    return rk.periodic_motion(scene, start, period, hold={"energy": None})


def energy(far):
    """Of a harmonic swing."""
    return G * HEIGHT + 0.7 * far**2


def family(motion, vary, span, points=12):
    return rk.periodic_family(motion.scene, motion, vary, span, points=points)


def test_a_window_of_instability_between_two_points():
    """Mathieu's third tongue, 5e-5 wide; x'' = -(d + y^2) x with y = A cos t.

    ``a = d + A^2 / 2``, ``q = A^2 / 4``; multipliers of 2 pi pass one.
    """

    def edge(characteristic):
        return brentq(
            lambda A: characteristic(3, A * A / 4) - 8.8 - A * A / 2, 0.3, 1.0
        )

    edges = [energy(edge(one)) for one in (mathieu_b, mathieu_a)]
    assert 0.0 < edges[1] - edges[0] < 1e-4
    found = family(swing(0.4, d=8.8, c=1.0), "energy", (energy(0.3), energy(1.0)))
    assert found.stable.all()  # none of its points lies in the window
    assert [one.kind for one in found.critical] == ["one", "one"]
    # an error of multipliers of 1e-11 shifts edges of a window of growth 2e-5 by some
    # 1e-11 / 2e-5 of its width
    values = [one.value for one in found.critical]
    np.testing.assert_allclose(values, edges, atol=1e-8)


def trace(far, d, e, c):
    """Of Hill's equation over a period, by another integrator."""

    def rates(t, y):
        u = far * np.cos(t)
        return [y[1], -(d + e * u + c * u * u) * y[0]]

    def grown(start):
        how = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15}
        return solve_ivp(rates, (0.0, 2.0 * np.pi), start, **how).y[:, -1]

    return grown([1.0, 0.0])[0] + grown([0.0, 1.0])[1]


@pytest.mark.slow
def test_a_window_of_period_doubling_between_two_points():
    """Where the trace is below -2, by 4e-7."""
    numbers = {"d": 2.2, "e": 0.05, "c": 0.4}
    least = minimize_scalar(
        lambda far: trace(far, **numbers), bracket=(0.495, 0.5, 0.51)
    ).x
    edges = [
        energy(brentq(lambda far: trace(far, **numbers) + 2.0, *sorted((least, end))))
        for end in (0.49, 0.51)
    ]
    found = family(swing(0.3, **numbers), "energy", (energy(0.2), energy(1.0)))
    assert found.stable.all()
    assert [one.kind for one in found.critical] == ["minus one"] * 2
    # likewise, with a growth of 7e-4; scipy's errors of 1e-12 as well
    values = [one.value for one in found.critical]
    np.testing.assert_allclose(values, edges, atol=1e-8)


def period(far):
    """Of y'' = -y - 2 y^3 + 1.5 y^5, by quadrature of its energy."""

    def slowness(u):
        a, b = far * far, (far * np.sin(u)) ** 2
        return 1.0 / np.sqrt(1.0 + (a + b) - 0.5 * (a * a + a * b + b * b))

    return 4.0 * quad(slowness, 0.0, np.pi / 2.0, epsabs=1e-14, epsrel=1e-13)[0]


@pytest.mark.slow
def test_a_fold_of_the_period_is_told():
    least = minimize_scalar(period, bracket=(0.4, 0.85, 1.25), tol=1e-13).fun
    begun = swing(0.4, period(0.4), d=2.3, four=1.0, six=0.5)
    found = family(begun, "period", (least - 0.3, period(0.4) + 0.2), points=10)
    assert found.ends == ("span", "span")
    (fold,) = found.critical
    assert fold.kind == "fold"
    # at its least; the period of a run to 1e-12
    assert fold.value == pytest.approx(least, abs=1e-10)


@pytest.mark.parametrize("strength", [1e-2, pytest.param(1e-5, marks=pytest.mark.slow)])
def test_a_family_that_goes_where_a_symmetry_is_lost_is_refused(strength):
    """Begun where x does not matter, far from the origin; a hill at its end does."""
    begun = swing(0.2, X=30.0, Y=20.0, k=strength)
    assert "translation x" in begun.group
    with pytest.raises(rk.FieldError, match=r"span: leads to.*no symmetry 'transl"):
        family(begun, "energy", (energy(0.1), energy(1.0)), points=5)
    # what would have been told stable grows by the force of the detent, 8 k x
    there = swing(1.0, X=30.0, Y=20.0, k=strength)
    assert "translation x" not in there.group
    assert not there.stable


@pytest.mark.slow
def test_a_driven_motion_has_no_family_of_other_periods():
    """Its scene repeats after the period of what drives it alone."""
    rate = 2.0
    shaken = rk.BaseMotion(
        lambda t: jnp.stack([0.02 * jnp.cos(rate * t), 0.0 * t, 0.0 * t])
    )
    losses = rk.RollingResistance(viscous=0.02), rk.SpinningResistance(viscous=0.02)
    bowl = rk.Base(rk.Graph(lambda x, y: 0.5 * (x * x + y * y)), shaken)
    scene = rk.Scene(BALL, bowl, loads=(rk.Gravity(), *losses))
    start = rk.place(scene, UPRIGHT, STILL, (0.02, 0.0, 0.0002))
    motion = rk.periodic_motion(scene, start, 2.0 * np.pi / rate)
    with pytest.raises(rk.FieldError, match=r"vary: is that of what drives"):
        family(motion, "period", (2.0, 4.0))
    span = (motion.energy - 0.01, motion.energy + 0.01)
    with pytest.raises(rk.FieldError, match="is isolated"):
        family(motion, "energy", span)


class Known:
    """A point of a branch whose exponents are known."""

    def __init__(self, s, exponents):
        self.exponents = np.array(sorted(exponents, key=lambda x: -x.real), complex)
        self.errors = np.full(self.exponents.size, 1e-12)
        self.unstable = int(np.sum(self.exponents.real > self.errors))
        self.determinants = ((0j, float(np.real(np.prod(self.exponents)))),)
        self.turning, self.s = 1.0, s


def test_what_passes_together_is_located():
    """Two alike, of which no determinant changes its sign; and what was family."""

    def way(at):
        return lambda base, far: at(base.s + far)

    def two(s):
        root = np.emath.sqrt(s - 0.3)
        return Known(s, [root, root, -root, -root])

    (one,) = critical_on(way(two), Segment(two(0.0), two(1.0), 1.0))
    # the square of a distance of two, to rounding
    assert one.point.s == pytest.approx(0.3, abs=1e-12)

    def more(s):
        return Known(s, [-1.0] if s < 0.3 else [s - 0.3, 0.3 - s, -1.0])

    segment = Segment(more(0.0), more(1.0), 1.0)
    assert critical_on(way(more), segment) == []
    (one,) = bisected(way(more), segment)
    assert one.kind == "zero crossing"
    assert one.point.s == pytest.approx(0.3, abs=1e-11)  # 2^-40 of it
