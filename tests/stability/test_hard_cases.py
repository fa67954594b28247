"""Hard cases stay within what is promised of them (docs/stability.md)."""

import pytest

from .hard_cases import CASES


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if case.slow else ())
        for name, case in CASES.items()
    ],
)
def test_hard_case(name):
    assert CASES[name].measure() <= CASES[name].limit
