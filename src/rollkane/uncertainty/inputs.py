"""Checks of what is given to the studies of a model's sensitivity."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..validation.checks import FieldError, real


def share(field: str, value: object) -> float:
    """A number between 0 and 1, neither of them [1].

    Raises:
        FieldError: it is not.
    """
    number = float(real(field, value, (), "a number between 0 and 1"))
    if not 0.0 < number < 1.0:
        problem = "must lie between 0 and 1"
        raise FieldError(field, value, problem, "give such a number, as 0.95")
    return number


def chosen_outputs(
    values: Mapping[str, np.ndarray], names: Sequence[str] | None, field: str
) -> tuple[str, ...]:
    """Names of outputs: those asked for, or all.

    Args:
        values: Outputs by name [each its unit].
        names: Asked for, or None.
        field: Name used in the error.

    Raises:
        FieldError: an unknown name, or one whose values are no real numbers.
    """
    chosen = tuple(values if names is None else names)
    for name in chosen:
        if name not in values:
            remedy = f"use one of {', '.join(sorted(values))}"
            raise FieldError(field, name, "is no output of the model", remedy)
        if values[name].dtype.kind not in "biuf":
            raise FieldError(field, name, "is not made of real numbers", "leave it out")
    return chosen
