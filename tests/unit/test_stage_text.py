"""Long programs in C: their order, and the functions that they are written as."""

import numpy as np
import pytest

from rollkane.codegen import stage_text
from rollkane.codegen.stage_text import Signature, Statement, function_source

from .test_native import STOPS, loop_of, queue_of


def test_statements_follow_what_they_need():
    listed = [
        *(Statement(f"s{i}", "row", f"y[{i}] * y[{i}]") for i in range(4)),
        *(Statement(f"s{4 + i}", "row", f"s{i} + s{i}") for i in range(4)),
        Statement("s8", "row", "s4 + s5"),
        Statement("s9", "row", "s6 + s7"),
    ]
    order = [x.name for x in stage_text.last_ready_first(listed)]
    # each number is used as soon as it is there
    assert order == ["s0", "s4", "s1", "s5", "s8", "s2", "s6", "s3", "s7", "s9"]


def test_pieces_hand_on_what_later_ones_use(monkeypatch):
    monkeypatch.setattr(stage_text, "_SHORT", 1)
    monkeypatch.setattr(stage_text, "_PIECE", 2)
    listed = [
        Statement("s0", "row", "y[0] * b0"),
        Statement("s1", "mask", "s0 < y[1]"),
        Statement("s2", "row", "choose_row(s1, s0, b0)"),
    ]
    signature = Signature("rates", ("const row *restrict y", "row *restrict d"))
    given = {"b0": "const real b0 = u[0];"}
    lines = function_source(signature, given, listed, ["d[0] = s2;"])
    text = "\n".join(lines)
    first, second = text.split("rates_1(", 1)[0], text.split("rates_1(", 1)[1]
    assert "kept_row[0] = s0;" in first
    assert "kept_mask[0] = s1;" in first
    assert "const row s0 = kept_row[0];" in second
    assert "const real b0 = u[0];" in first
    assert "rates_0(y, d, kept_mask, kept_row);" in second


@pytest.mark.parametrize("lanes", [1, 8])
def test_a_program_in_pieces_is_the_same(monkeypatch, lanes):
    """Every operation, kind of number and table, in functions of 20 statements."""
    queue = queue_of(64)
    tolerant, steps = np.full_like(queue.atol, 1e9), np.full(64, 0.1)
    # one step of 0.1 s, whatever its error: some rates jump
    queue = queue._replace(max_steps=1, atol=tolerant, first_steps=steps)
    whole = loop_of(lanes=lanes)
    monkeypatch.setattr(stage_text, "_SHORT", 20)
    monkeypatch.setattr(stage_text, "_PIECE", 20)
    pieces = loop_of(lanes=lanes)
    assert "rates_1(" in pieces.source
    assert "rates_1(" not in whole.source
    one, other = whole.run(queue, STOPS), pieces.run(queue, STOPS)
    # compilers join products and sums, or not: some tens of roundings
    close = 50 * np.finfo(float).eps
    np.testing.assert_allclose(other.final_y, one.final_y, rtol=0, atol=close)
    assert np.ptp(one.final_y - queue.starts, axis=0).min() > 1e-4  # they do differ
