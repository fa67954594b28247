"""Arguments of a system that are several, or count something of it."""

import operator
from collections.abc import Iterable
from typing import Any

from ..validation.checks import FieldError, whole
from ..validation.function_errors import ReturnedShapeError
from ..validation.user_functions import GivenFunction
from .parts import Wrap


def in_a_row(field: str, given: Any) -> tuple[Any, ...]:
    """Several, as a tuple.

    Raises:
        FieldError: it is one, and not in a row.
    """
    try:
        return tuple(given)
    except TypeError as error:
        name = field.rpartition(".")[2]
        problem, remedy = "must be several in a row", f"give a list, {name}=[...]"
        raise FieldError(field, given, problem, remedy) from error


def counts_of(**given: Any) -> tuple[int, ...]:
    """How many of each there are: of speeds one at least."""
    return tuple(
        whole(f"KaneSystem.{name}", count, int(name == "speeds"), "say how many")
        for name, count in given.items()
    )


def chosen_numbers(
    field: str, numbers: Iterable[int] | None, count: int
) -> tuple[int, ...]:
    """Different numbers of speeds or coordinates; None: none.

    Raises:
        FieldError: one that there is not, one twice, or what is no whole number.
    """
    numbers = () if numbers is None else numbers
    given = in_a_row(field, numbers)
    try:
        chosen = tuple(operator.index(k) for k in given)
        good = len(set(chosen)) == len(chosen) and all(0 <= k < count for k in chosen)
    except TypeError:  # a text, or a fraction
        chosen, good = (), False
    if not good:
        raise FieldError(
            field,
            numbers,
            "must be different numbers of those that there are",
            f"give numbers from 0 to {count - 1}",
        )
    return chosen


def refuse_all(dependent: tuple[int, ...], speeds: int) -> None:
    """Refuse dependent speeds beside which there are no others."""
    if len(dependent) < speeds:
        return
    raise FieldError(
        "KaneSystem.dependent",
        dependent,
        f"are all {speeds} speeds, and none is left whose equation could be solved",
        "give dependent=None, by which all that moves may be driven, or leave out a "
        "constraint",
    )


def refuse_no_rows(count: int, constraints: object) -> None:
    """Refuse constraints by multipliers of which there is none."""
    if count:
        return
    problem, remedy = "returns no rows", "leave it out, and dependent=None, too"
    raise FieldError("KaneSystem.constraints", constraints, problem, remedy)


def bound_by(
    motion: Wrap,
    name: str,
    function: Any,
    of: str,
    chosen: tuple[int, ...],
) -> GivenFunction | None:
    """Constraints, one for each number that they determine."""
    if function is None and chosen:
        problem, remedy = "are not determined by anything", f"give {name}, one for each"
        raise FieldError(f"KaneSystem.{of}", chosen, problem, remedy)
    if function is None:
        return None
    if not chosen:
        problem, remedy = f"does not say what {name} determines", "give as many numbers"
        raise FieldError(f"KaneSystem.{of}", chosen, problem, remedy)
    return one_each(motion, name, function, of, chosen)


def one_each(
    motion: Wrap,
    name: str,
    function: Any,
    of: str,
    given: tuple[Any, ...],
) -> GivenFunction | None:
    """A function of as many rows as another argument has entries; None of None.

    Raises:
        FieldError: entries that do not fit its rows, or what ``motion`` refuses.
    """
    if function is None:
        if given:
            problem, remedy = f"has {len(given)}, and no {name}", f"give {name}"
            raise FieldError(f"KaneSystem.{of}", given, problem, remedy)
        return None
    try:
        return motion(f"KaneSystem.{name}", function, (len(given),))
    except ReturnedShapeError as error:
        if error.shape is None or len(error.shape) != 1:
            raise
        problem = f"has {len(given)} for the {error.shape[0]} rows that {name} returns"
        remedy = "give one for each row, or return as many rows"
        raise FieldError(f"KaneSystem.{of}", given, problem, remedy) from error


def names_of_rows(given: Any) -> tuple[str, ...]:
    """Names of rows."""
    field = "KaneSystem.implied_names"
    names = in_a_row(field, given)
    if isinstance(given, str) or not all(isinstance(name, str) for name in names):
        remedy = 'give one for each row of implied, for example ["closes along x"]'
        raise FieldError(field, given, "must be several texts in a row", remedy)
    return names
