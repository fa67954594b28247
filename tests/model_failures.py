"""Models some of whose motions fail, for tests of what is made of the others."""

import numpy as np

from rollkane.uncertainty.evaluation import Evaluated


class Failing:
    """A model whose motions fail at random, or where a function of u says so."""

    def __init__(self, model, share=0.0, seed=0, where=None):
        self.model, self.share, self.where = model, share, where
        self.random = np.random.default_rng(seed)
        self.draws = model.draws
        self.bad = np.zeros(0, bool)

    def evaluate(self, u):
        values, code = self.model.evaluate(u)
        bad = self.random.random(len(u)) < self.share
        if self.where is not None:
            bad |= self.where(u)
        self.bad = bad
        spoilt = {
            name: np.where(bad.reshape(-1, *(1,) * (x.ndim - 1)), np.nan, x)
            for name, x in values.items()
        }
        return Evaluated(spoilt, np.where(bad, 1, code))
