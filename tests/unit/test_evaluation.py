"""Functions of known arrays, evaluated while they are walked: what XLA gives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.codegen import compile_effort, evaluation
from rollkane.codegen.compile_effort import for_few_operations
from rollkane.codegen.evaluation import evaluated
from rollkane.codegen.scalar_program import NotElementwiseError

X = jnp.array([0.3, -0.5, 0.9])
STILL = (0.0, 0.0, 0.0)


def of_many_kinds(tree, name):
    """Trees, shapes and types of many kinds; ``name`` is no array."""
    x, count = tree["x"], tree["count"]
    turned = jnp.where(x > 0.0, jnp.sqrt(jnp.abs(x)), -(x**3))
    chosen = jax.lax.cond(count > 2, lambda: x @ x, lambda: jnp.zeros((), x.dtype))
    return {
        "matrix": jnp.stack([turned, jnp.roll(x, 1)]) / x[1],
        "chosen": chosen,
        "cosine": jnp.cos(x[0]),
        "fine": jnp.isfinite(turned / (x - x)),
        "next": count + 1,
        "none": jnp.zeros((0, 2), x.dtype),
        "name": name,
    }


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("count", [1, 3])
def test_it_is_what_xla_gives(dtype, count):
    tree = {"x": X.astype(dtype), "count": jnp.asarray(count)}
    found = evaluated(of_many_kinds, tree, "a name")
    wanted = jax.jit(lambda tree: {**of_many_kinds(tree, ""), "name": 0})(tree)
    assert found.pop("name") == "a name"
    for key, x in found.items():
        assert isinstance(x, jax.Array)
        assert (x.shape, x.dtype) == (wanted[key].shape, wanted[key].dtype)
        # sums of three products and a quotient: four roundings, of XLA's or of these
        eps = float(np.finfo(dtype).eps)
        np.testing.assert_allclose(x, wanted[key], rtol=4.0 * eps)


def test_what_is_long_is_refused():
    loop = lambda x: jax.lax.fori_loop(0, 3, lambda i, y: y * 2.0, x)
    inner = lambda x: jax.lax.cond(x[0] > 0.0, loop, lambda y: y, x)
    for function in (loop, inner, jax.jit(loop)):
        with pytest.raises(NotElementwiseError):
            evaluated(function, X)
    with pytest.raises(NotElementwiseError):
        evaluated(lambda x: 2.0 * x, jnp.zeros(evaluation._MOST + 1))
    with pytest.raises(NotElementwiseError):
        evaluated(lambda x: jnp.sum(jnp.outer(x, x)), jnp.ones(100))
    with pytest.raises(NotElementwiseError):
        evaluated(jnp.cos, jnp.ones(evaluation._MOST // evaluation._BY_XLA + 1))


def test_within_a_trace_alone_and_what_is_long_is_compiled():
    walked, x = [], jnp.asarray(0.25)
    short = for_few_operations(lambda x: walked.append(0) or 2.0 * x)
    assert jax.jit(lambda y: float(short(x)) * y)(2.0) == 1.0
    # traced anew, and never compiled
    assert len(walked) == 1
    assert jax.jit(lambda y: float(short(x)) * y)(3.0) == 1.5
    assert len(walked) == 2
    assert short(x) == short(x) == 0.5
    assert len(walked) == 3

    long = for_few_operations(
        lambda x: walked.append(1) or jax.lax.fori_loop(0, 2, lambda i, y: y + y, x)
    )
    for _ in range(3):
        assert jax.jit(lambda y: float(long(x)) + y)(1.0) == 2.0
    # once to see that it is, once to compile it
    assert sum(walked) == 2


SURFACES = {
    "sphere": rk.Sphere(0.2),
    "ellipsoid": rk.Ellipsoid((0.1, 0.2, 0.3)),
    "ring": rk.Ring(0.2),
    "torus": rk.Torus(0.3, 0.1),
}


@pytest.mark.parametrize("name", SURFACES)
def test_a_body_is_placed_within_a_trace_as_outside_of_it(name, monkeypatch):
    scene = rk.Scene(rk.Body(1.0, np.eye(3), SURFACES[name]))
    random = np.random.default_rng(3)
    counted = []

    def counting(function, *arguments):
        counted.append(function.__name__)
        return evaluated(function, *arguments)

    monkeypatch.setattr(compile_effort, "evaluated", counting)
    for _ in range(3):
        q = random.normal(size=4)
        q, w, at = q / np.linalg.norm(q), random.normal(size=3), random.normal(size=3)
        at[2] = 0.0
        outside = rk.place(scene, q, w, at)
        inside = jax.jit(lambda w: rk.place(scene, q, w, at))(w)  # noqa: B023
        for a, b in zip(*map(jax.tree.leaves, (outside, inside)), strict=True):
            # rounded otherwise: some ten operations on numbers up to 3
            np.testing.assert_allclose(a, b, rtol=0, atol=10 * 3 * 2.2e-16)
    assert counted == ["_fit"] * 3


def test_a_body_that_cannot_be_placed_is_refused_within_a_trace():
    scene = rk.Scene(rk.Body(1.0, np.eye(3), rk.Sphere(0.2)))
    put = lambda w: rk.place(scene, (1.0, 0.0, 0.0, 0.0), w, (0.0, 0.0, 1.0))
    with pytest.raises(rk.FieldError, match="contact_on_base"):
        put(STILL)
    inside = jax.jit(put)(jnp.zeros(3))
    assert jnp.isnan(inside.angular_velocity).all()
