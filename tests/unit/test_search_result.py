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
    scale = np.array([2.0, 5.0])
    found = spectrum(Evaluation(np.zeros(3), slopes, 0), scale)
    assert not found.seen.any()
    assert found.condition == np.inf
    whole = np.where(np.isnan(slopes), 1.0, slopes)
    assert spectrum(Evaluation(np.zeros(3), whole, 0), scale).seen.all()


def test_a_prior_is_as_exact_as_it_is_firm():
    """Its row hides no other, whether samples show its number, or nothing at all."""
    samples = np.array([[1.0, 0.5, 0.0], [2.0, 3.0, 0.0]])
    scale = np.ones(3)
    for firm in (1e-3, 1.0, 1e12):
        rows = np.concatenate([samples, [[0.0, 0.0, firm]]])
        at = Evaluation(np.zeros(3), rows, 0, rounding=1e-9, priors=1)
        assert spectrum(at, scale).seen.all()
        nothing = np.concatenate([0.0 * samples, firm * np.eye(3)])
        at = Evaluation(np.zeros(5), nothing, 0, rounding=1e-9, priors=3)
        assert spectrum(at, scale).seen.all()
    # one of samples of that length is as uncertain as it is long
    at = Evaluation(np.zeros(3), rows, 0, rounding=1e-9)
    assert spectrum(at, scale).seen.sum() == 1
