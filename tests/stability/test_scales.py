"""A part of benchmarks/scales.py: scenes from 1e-9 to 1e9 m have to keep energy."""

import functools

import numpy as np
import pytest

import rollkane as rk

from .scales import KINDS, LIMIT, drawn_numbers, excess, failures, run

# an edge that does not bend across, and metres beside angles in one chart
QUICK = "disc on a plane, rubber", "sphere in a spinning cone"


@functools.cache
def quick(name):
    return run(name, drawn_numbers(name, 40, seed=1))


@pytest.mark.parametrize("name", QUICK)
def test_energy_is_kept_at_every_size(name):
    found = quick(name)
    assert found.code.shape == (40,)
    assert np.ptp(np.log10(found.size)) > 15.0
    # nothing is refused at one end of the range and not at the other
    assert (found.code == rk.Code.COMPLETED).all()
    assert failures(found) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_energy_is_kept_in_all_kinds(name):
    numbers = drawn_numbers(name, 250)
    at_one_metre = numbers.copy()
    at_one_metre[:, 0] = 0.5  # the size is drawn first
    found = run(name, np.concatenate([numbers, at_one_metre]))
    assert failures(found) == []
    # a ring that lies nearly flat would cut into its bowl, but so it would at 1 m
    np.testing.assert_array_equal(*np.split(found.code, 2))
    assert (found.code == rk.Code.COMPLETED).mean() > 0.95


def test_energy_that_is_not_kept_fails():
    # a turntable gives energy: what is kept is the moving one
    found = quick("sphere in a spinning cone")
    wrong = found._replace(kept=found.kept + found.given, given=0.0 * found.given)
    assert len(failures(wrong)) == 40
    # nor does a drift of two millionths pass, 2e-6 / rtol of the energy of the motion
    drift = 2e-6 * found.kinetic[:, :1] * np.linspace(0.0, 1.0, found.kept.shape[1])
    still = np.max(np.abs(found.kinetic), axis=1) / found.kinetic[:, 0]
    over = excess(found._replace(kept=found.kept + drift))
    assert (over[still < 1.5] > 0.2 * LIMIT).all()
