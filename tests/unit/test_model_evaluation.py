"""Plain functions as models: names, blocks, gradients, failures."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.uncertainty.distributions import Normal, Uniform
from rollkane.uncertainty.evaluation import entry, failures
from rollkane.uncertainty.standard_normal import slopes_by_normal, to_normal, to_uniform

DRAWS = {"a": Uniform(1.0, 3.0), "b": Normal([0.0, 0.0], 1.0)}


def made(drawn):
    return {"sum": drawn["a"] + drawn["b"].sum(), "b": drawn["b"]}


@pytest.mark.parametrize("count", [0, 1, 7, 9000])
def test_members_are_evaluated_one_by_one(count):
    """Whatever blocks they are in."""
    model = rk.FunctionModel(made, DRAWS)
    u = np.random.default_rng(1).random((count, 3))
    values, code = model.evaluate(u)
    assert values["b"].shape == (count, 2)
    normal = to_normal(u[:, 1:])
    # quantiles by two methods: some roundings
    np.testing.assert_allclose(values["b"], normal, rtol=1e-12, atol=1e-14)
    expected = 1.0 + 2.0 * u[:, 0] + normal.sum(axis=1)
    np.testing.assert_allclose(values["sum"], expected, rtol=1e-12, atol=1e-13)
    assert not code.any()


def test_an_array_is_called_value():
    model = rk.FunctionModel(lambda drawn: drawn["a"], DRAWS)
    assert list(model.evaluate(np.full((2, 3), 0.5)).values) == ["value"]


def test_nan_is_a_failure():
    model = rk.FunctionModel(lambda drawn: jnp.sqrt(drawn["a"] - 2.0), DRAWS)
    u = np.array([[0.25, 0.5, 0.5], [0.75, 0.5, 0.5]])
    values, code = model.evaluate(u)
    assert code.tolist() == [1, 0]
    assert failures(model, code) == {"the function gave NaN": 1}
    slopes = model.value_and_gradient(u)
    assert slopes.code.tolist() == [1, 0]
    assert np.isfinite(values["value"][1])


def test_gradients():
    """By u: 2 for a uniform number of width 2; by z: 1 for a normal one."""
    model = rk.FunctionModel(made, DRAWS)
    u = np.random.default_rng(1).random((20, 3))
    values, gradients, code = model.value_and_gradient(u, "sum")
    np.testing.assert_allclose(gradients[:, 0], 2.0, rtol=1e-12)
    by_normal = slopes_by_normal(to_normal(u), gradients)
    np.testing.assert_allclose(by_normal[:, 1:], 1.0, rtol=1e-10)
    np.testing.assert_allclose(values, model.evaluate(u).values["sum"], rtol=1e-14)
    assert not code.any()
    of_second = model.value_and_gradient(u, "b[-1]").gradients
    assert (of_second[:, :2] == 0.0).all()


def test_normal_numbers_stay_open():
    """However far z is, u is between 0 and 1 and no end of it."""
    u = to_uniform(np.array([[-40.0, 0.0, 40.0]]))
    assert ((u > 0.0) & (u < 1.0)).all()
    assert u[0, 1] == 0.5


def test_entries_by_name():
    values = {"end": np.arange(6.0).reshape(2, 3), "grid": np.ones((2, 2, 2))}
    assert entry(values, "end[-1]", "of").tolist() == [2.0, 5.0]
    assert entry(values, "grid[1][0]", "of").shape == (2,)
    for name in ("end", "end[3]", "end[0][0]", "grid[0]"):
        with pytest.raises(rk.FieldError, match="is not one number"):
            entry(values, name, "of")
    with pytest.raises(rk.FieldError, match="use one of end, grid"):
        entry(values, "start[0]", "of")


def test_no_function_is_refused():
    with pytest.raises(rk.FieldError, match="is no function"):
        rk.FunctionModel(3.0, DRAWS)  # pyright: ignore[reportArgumentType]
