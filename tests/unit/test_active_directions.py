"""Active directions: outputs whose gradients are known."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.uncertainty.distributions import Normal
from rollkane.uncertainty.evaluation import FunctionModel, Slopes

from .test_sobol_indices import MODEL, TOTAL


def test_a_linear_output_has_one_direction():
    """Of a combination of normal numbers: the combination, in their deviations."""
    stds, weights = np.array([2.0, 0.5]), np.array([1.0, -3.0])
    draws = {"p": Normal(np.zeros(2), stds), "q": Normal(4.0, 0.1)}
    model = FunctionModel(lambda d: d["p"] @ weights + d["q"], draws)
    found = rk.active_directions(model, size=50)
    slope = np.array([2.0, -1.5, 0.1])
    # u = Phi(z) and back, and products: roundings
    np.testing.assert_allclose(found.matrix, np.outer(slope, slope), atol=1e-9)
    np.testing.assert_allclose(found.eigenvalues, [slope @ slope, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(
        found.directions[:, 0], slope / np.linalg.norm(slope), atol=1e-9
    )
    np.testing.assert_allclose(found.activity, [6.25, 0.01], rtol=1e-7)
    assert found.names == ("p[0]", "p[1]", "q")
    assert found.factors == ("p", "q")
    # the bound is the index itself, 0.01 / 6.26, but for the variance of 50 draws:
    # four deviations sqrt(2 / 50) of it
    assert abs(found.total_bound[1] * 6.26 / 0.01 - 1.0) < 4.0 * 0.2 / (1.0 - 0.8)
    assert found.subspace_error[0] < 1e-7
    assert "direction 1: +0.799 p[0], -0.600 p[1], +0.040 q" in str(found)


def test_a_quadratic_output():
    """Of z H z / 2 the matrix is H^2."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    H = turn @ np.diag([3.0, 1.0, 0.3]) @ turn.T
    draws = {"z": Normal(np.zeros(3), 1.0)}
    model = FunctionModel(lambda d: 0.5 * d["z"] @ H @ d["z"], draws)
    found = rk.active_directions(model, size=4000, level=0.999)
    low, high = found.eigenvalue_interval
    assert (low < [9.0, 1.0, 0.09]).all()
    assert (high > [9.0, 1.0, 0.09]).all()
    # the angle between sample and true eigenvectors: lambda_i lambda_j over the gap,
    # over sqrt(n): 3 / 8 / 63, and 0.3 / 0.91 / 63; the sum of two of them
    assert abs(found.directions[:, 0] @ turn[:, 0]) > np.cos(8.0 * 3.0 / 8.0 / 63.0)
    # what the bootstrap says of the first one is that size
    assert 0.3 < found.subspace_error[0] * 63.0 * 8.0 / 3.0 < 3.0
    assert found.mean == pytest.approx(0.5 * np.trace(H), abs=4 * np.sqrt(5.05 / 4000))


def test_bounds_are_above_total_indices():
    found = rk.active_directions(MODEL, size=2000)
    low, _ = found.total_bound_interval
    assert (found.total_bound >= TOTAL).all()
    assert low[2] > TOTAL[2]  # 0.56 of 0.24: below 1, so that it says something
    assert found.total_bound[2] < 0.7


def test_a_bound_that_is_reached():
    """Log-normal numbers: exp(a z) has the total index 1 and a bound above it."""
    draws = {"x": Normal(0.0, 0.5), "y": Normal(0.0, 0.001)}
    model = FunctionModel(lambda d: jnp.exp(d["x"] + d["y"]), draws)
    found = rk.active_directions(model, size=500)
    assert found.total_bound[0] == 1.0  # bounds end there
    # y: 0.001^2 E x^2 / V = 1e-6 / (1 - exp(-0.25)) = 4.52e-6; of 500 draws of x, both
    # moments move together, and a third is three deviations of their quotient
    assert abs(found.total_bound[1] / 4.52e-6 - 1.0) < 1.0 / 3.0


class Broken:
    """Every other motion fails, with gradients that are no numbers."""

    def __init__(self, model):
        self.model, self.draws = model, model.draws

    def value_and_gradient(self, u, of):
        values, gradients, code = self.model.value_and_gradient(u, of)
        code = np.where(np.arange(len(u)) % 2, 9, code)
        return Slopes(values, np.where(code[:, None] > 0, np.nan, gradients), code)


def test_failed_motions_are_left_out_and_told():
    model = FunctionModel(lambda d: d["z"] @ jnp.arange(1.0, 3.0), normals(2))
    found = rk.active_directions(Broken(model), size=100)
    np.testing.assert_allclose(found.eigenvalues, [5.0, 0.0], atol=1e-9)
    assert found.failed == 50
    assert "WARNING: 50 of 100 motions FAILED" in str(found)
    assert "surface ends" in str(found)  # what code 9 says


def normals(count):
    return {"z": Normal(np.zeros(count), 1.0)}


def test_one_of_many_outputs():
    model = FunctionModel(lambda d: {"path": jnp.outer(d["z"], d["z"])}, normals(2))
    found = rk.active_directions(model, "path[0][1]", 300)
    # z0 z1 has gradient (z1, z0): the unit matrix; 300 draws tell each entry to
    # sqrt(2 / 300)
    np.testing.assert_allclose(found.matrix, np.eye(2), atol=4 * np.sqrt(2 / 300))
    with pytest.raises(rk.FieldError, match="is not one number"):
        rk.active_directions(model, "path", 300)


def test_refusals():
    class Without:
        draws = MODEL.draws
        evaluate = MODEL.evaluate

    with pytest.raises(rk.FieldError, match="has no gradients"):
        rk.active_directions(Without())
    with pytest.raises(rk.FieldError, match="is no output"):
        rk.active_directions(MODEL, "end")
    with pytest.raises(rk.FieldError, match="at least 2"):
        rk.active_directions(MODEL, size=1)
    undefined = FunctionModel(lambda d: jnp.sqrt(-1.0 - d["z"][0] ** 2), normals(1))
    with pytest.raises(rk.FieldError, match="did not fail"):
        rk.active_directions(undefined)
