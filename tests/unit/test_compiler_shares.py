"""Long functions in C whose pieces are compiled side by side."""

import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.codegen import derivative_loops
from rollkane.codegen.compiler_shares import apart
from rollkane.codegen.stage_text import PIECE, Signature, Statement, function_source
from rollkane.files.scene_files.loading import load_scene


def long_function(count):
    """A function of a chain of statements, which is written in pieces."""
    chain = [Statement("x0", "row", "y[0]")]
    chain += [
        Statement(f"x{i}", "row", f"x{i - 1} + y[0] / x{i - 1}")
        for i in range(1, count)
    ]
    signature = Signature("rates", ("const row *restrict y", "row *restrict d"))
    lines = function_source(signature, {}, chain, [f"d[0] = x{count - 1};"])
    return "\n".join(lines)


def test_pieces_are_declared_where_they_are_called(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    text = long_function(4000)
    heads = [line for line in text.splitlines() if line.startswith(PIECE)]
    assert len(heads) == 8
    (before, after), others = apart(("int first;", text))
    assert before == "int first;"
    ((names, *moved),) = others
    assert names == "rows.h"
    for k, head in enumerate(heads):
        name = head.removeprefix(f"{PIECE}void ").partition("(")[0]
        declared = f"OF_THE_PROGRAM void {name}(" in after
        defined = any(x.startswith(f"OF_THE_PROGRAM void {name}(") for x in moved)
        assert name == f"rates_{k}"
        assert declared == defined == (f"{PIECE}void {name}(" not in after)
    # no statement is lost, and none there twice
    both = "\n".join((after, *moved))
    assert all(both.count(f"const row x{i} = x{i - 1} +") == 1 for i in range(1, 4000))


def test_short_functions_stay_together(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    texts = long_function(300), long_function(1001)
    assert apart(texts[:1]) == (texts[:1], ())
    assert apart(texts) == (texts, ())


def test_a_gradient_is_the_same_to_the_last_bit(monkeypatch):
    """Of an isolator on its record, whose way back is two and a half thousand lines."""
    file = load_scene("isolator")
    shares = []

    def told(texts):
        found = apart(texts)
        shares.append(len(found[1]))
        return found

    def end(mass):
        scene = eqx.tree_at(lambda x: x.body.mass, file.scene, mass)
        run = rk.simulate(scene, file.start, (0.0, 0.1), method="native")
        return jnp.sum(run.final_state.angular_velocity)

    monkeypatch.setattr(derivative_loops, "apart", told)
    found = []
    for processors in (1, 2):
        monkeypatch.setattr(os, "cpu_count", lambda count=processors: count)
        jax.clear_caches()
        found.append(np.asarray(jax.grad(end)(file.scene.body.mass)))
    assert shares == [0, 1]
    assert np.isfinite(found[0]).all()
    assert found[0].tobytes() == found[1].tobytes()
