"""Values of options that are given by name, or as several numbers."""

from collections.abc import Sequence
from typing import Any

from .option_values import refuse


def pairs(option: str, given: Sequence[str]) -> dict[str, str]:
    """``NAME=TEXT`` of an option that may be given several times."""
    found: dict[str, str] = {}
    for one in given:
        name, equals, text = one.partition("=")
        if not equals or not name.strip() or not text.strip():
            refuse(f"--{option}", f"{one!r} is not NAME=VALUE")
        name = name.strip()
        # the names of channels are those of options, too: contact-path
        if name.replace("-", "_") in {known.replace("-", "_") for known in found}:
            refuse(f"--{option}", f"names {name} twice")
        found[name] = text.strip()
    return found


def numbers(option: str, text: str) -> list[float | None]:
    """Numbers between commas; None where there is nothing."""
    try:
        return [float(part) if part.strip() else None for part in text.split(",")]
    except ValueError:
        refuse(f"--{option}", f"{text!r} is not made of numbers between commas")


def two(option: str, text: str) -> tuple[float | None, float | None]:
    """Two of them."""
    found = numbers(option, text)
    if len(found) != 2:
        refuse(f"--{option}", f"{text!r} is not two numbers with a comma between them")
    return found[0], found[1]


def each(option: str, text: str) -> Any:
    """One number, or a list of several."""
    found = numbers(option, text)
    return found[0] if len(found) == 1 else found
