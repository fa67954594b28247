"""What a search returns can be written as JSON."""

import json

import numpy as np

from rollkane.identification.least_squares import Evaluation, minimize
from rollkane.identification.uncertainty import spectrum


def test_convergence_is_a_plain_truth_value():
    """After accepted steps, too, whose damping is a NumPy number."""
    slope = np.array([[1.0], [2.0]])
    away = np.array([1.0, -1.0])
    evaluate = lambda z: Evaluation(slope @ np.sinh(z) - away, slope * np.cosh(z), 0)
    one = np.ones(1)
    found = minimize(evaluate, 3.0 * one, -np.inf * one, np.inf * one, one)
    assert len(found.path) > 1
    assert json.dumps(found.converged) == "true"


def test_slopes_that_are_no_numbers_show_nothing():
    """A search may end where derivatives of the run are not finite."""
    slopes = np.array([[1.0, np.nan], [2.0, 3.0], [0.5, 1.0]])
    found = spectrum(slopes, np.array([2.0, 5.0]))
    assert not found.seen.any()
    assert found.condition == np.inf
    whole = np.where(np.isnan(slopes), 1.0, slopes)
    assert spectrum(whole, np.array([2.0, 5.0])).seen.all()
