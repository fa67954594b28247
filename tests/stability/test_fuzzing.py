"""A short run of benchmarks/fuzz.py: other seeds than its own ten thousand scenes."""

import pytest

from .fuzzing import drawn_kind, drawn_numbers, run, unexplained


@pytest.mark.parametrize(
    "seed",
    [
        10_000,
        *(pytest.param(s, marks=pytest.mark.slow) for s in range(10_001, 10_008)),
    ],
)
def test_every_run_ends_and_says_how(seed):
    found = run(drawn_kind(seed), drawn_numbers(seed, 50))
    assert found.code.shape == (50,)
    assert unexplained(found) == []
