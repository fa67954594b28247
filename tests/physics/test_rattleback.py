"""A rattleback's rocking and growth against the formula for small spin and skew.

To first order in both, the growth rates have the four factors of A. Garcia and M.
Hubbard's formula ("Spin reversal of the rattleback: theory and experiment", Proc. R.
Soc. Lond. A 418 (1988), 165-197) that the abstract of Y. Kondo and H. Nakanishi, Phys.
Rev. E 95 (2017), 062207, arXiv:1704.06717, names: skew angle, difference of the inverse
moments of inertia of both oscillations, difference of the radii of curvature, squared
frequency. What else is in it, and the sign, is derived: docs/theory.md, (10.7).
Pitching and rolling grow in the ratio of minus their squared frequencies, as in H. K.
Moffatt and T. Tokieda, Proc. R. Soc. Edinb. A 138 (2008), 361-368.
"""

import numpy as np
import pytest

import rollkane as rk

G = 9.81
MASS, HEIGHT = 1.3, 0.011  # of the mass centre above the table
AXES, LOWERED = (0.1, 0.04, 0.02), 0.009
MOMENTS = 3e-4, 1.5e-3, 1.7e-3


def stone(skew):
    """Curvature along x and y, inertia turned by the skew angle."""
    cos, sin = np.cos(skew), np.sin(skew)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    inertia = turn @ np.diag(MOMENTS) @ turn.T
    centre = (0.0, 0.0, -LOWERED)
    return rk.Scene(rk.Body(MASS, inertia, rk.Ellipsoid(AXES), centre))


def published(skew, spin):
    """Pitch's and roll's frequencies [rad/s] and growth rates [1/s], to first order.

    Pitch tilts x, where the radius of curvature is the larger one, and turns about y.
    Moments are about the contact.
    """
    a, b, c = AXES
    radii = np.array([a * a, b * b]) / c
    moments = np.array([MOMENTS[1], MOMENTS[0]]) + MASS * HEIGHT**2
    squares = MASS * G * (radii - HEIGHT) / moments
    inverses, width = 1.0 / moments[1] - 1.0 / moments[0], radii[0] - radii[1]
    factors = skew * inverses * width * squares
    coupling = 0.5 * MASS * HEIGHT * spin / (squares[1] - squares[0])
    return np.sqrt(squares), coupling * factors * [1.0, -1.0]


def found(skew, spin):
    scene = stone(skew)
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, spin), (0.0, 0.0, 0.0))
    motion = rk.steady_motion(scene, start, ("spin",))
    values = motion.eigenvalues[motion.eigenvalues.imag > 0.0]
    values = values[np.argsort(-values.imag)]
    assert values.size == 2
    return values.imag, values.real


def test_growth_of_pitch_and_roll_tends_to_the_published_formula():
    """What is left out is of second order: signs cannot tell skew and spin apart.

    A mirror turns the signs of both and keeps growth; so does time run backwards, which
    turns spin and growth.
    """
    sizes = 0.04 / 2.0 ** np.arange(4)  # of the skew [rad], and of a tenth of the spin
    errors: list[np.ndarray] = []
    for size in sizes:
        given = size, 10.0 * size
        parts = zip(found(*given), published(*given), strict=True)
        errors.append(np.concatenate([own / known - 1.0 for own, known in parts]))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    # the next terms are smaller by d s^2 with d of some ten, which makes the order
    # miss by d (s_2^2 - s_3^2) / ln 2 = 1e-3 d / 9; rounding of a growth of 2e-3,
    # 1e-11, is 1e-5 of its error
    np.testing.assert_allclose(order[-1], 2.0, rtol=0, atol=4e-3)
    assert np.all(np.abs(order[-1] - 2.0) < 0.3 * np.abs(order[-2] - 2.0))
    # second order: moments that differ fivefold, a spin of ten times the skew beside
    # frequencies 18 rad/s apart, give coefficients of some twenty
    assert np.max(np.abs(errors[-1])) < 40.0 * sizes[-1] ** 2


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_pitch_and_roll_grow_in_opposite_senses(sense):
    """In the ratio of minus their squared frequencies, as Moffatt and Tokieda say."""
    frequencies, growths = found(0.005, sense * 0.05)
    ratio = growths[0] / growths[1]
    # second order in 0.005 and 0.05, with a coefficient of some ten
    assert abs(ratio / -((frequencies[0] / frequencies[1]) ** 2) - 1.0) < 5e-4
    assert np.sign(growths[0]) == np.sign(published(0.005, sense)[1][0])
