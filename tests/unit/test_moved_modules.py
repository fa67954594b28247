"""Modules are found by the names that they had before, for one release."""

import importlib
import sys

import pytest

from rollkane.moved_modules import NEW


@pytest.mark.parametrize("name", NEW)
def test_former_names(name):
    """They are the same modules, as they were: by import, and as attributes."""
    module = importlib.import_module(f"rollkane.{NEW[name]}")
    assert importlib.import_module(f"rollkane.{name}") is module
    assert module.__spec__.name == module.__name__ == f"rollkane.{NEW[name]}"
    if "." not in name:
        assert getattr(importlib.import_module("rollkane"), name) is module


def test_names_that_never_were_are_not_found():
    with pytest.raises(ModuleNotFoundError, match="no_such"):
        importlib.import_module("rollkane.no_such")
    assert "rollkane.no_such" not in sys.modules
