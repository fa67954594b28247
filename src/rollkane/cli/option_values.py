"""Options that several commands have, and how they refuse what was given."""

import math
from typing import NoReturn

import click

quiet_option = click.option(
    "--quiet", "-q", is_flag=True, help="Print nothing but errors."
)
verbose_option = click.option(
    "--verbose", "-v", is_flag=True, help="Print which loop ran, and why."
)


def refuse(option: str, message: str) -> NoReturn:
    """Refuse what was given for an option such as ``--vary``, with exit code 2.

    Raises:
        click.BadParameter: always.
    """
    raise click.BadParameter(message, param_hint=f"'{option}'")


def finite_number(option: str, text: str, what: str = "") -> float:
    """A number that was given for an option.

    Args:
        option: Its name, ``--vary``.
        text: What was given.
        what: Name of the number, for the error; none by default.

    Raises:
        click.BadParameter: no number, or none that is finite.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        named = f"{what}: " if what else ""
        refuse(option, f"{named}{text.strip()!r} is not a finite number")
    return value
