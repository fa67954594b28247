"""From checked tables to loads, the contact law, and how the contact may change."""

from typing import Any

from ...dynamics.loads import AbstractLoad, Gravity
from ...dynamics.scene import Rolling, Slipping
from ...hybrid.modes import Modes
from .checking import likely_kind
from .construction import made_from
from .derived_tables import DerivedTable
from .load_tables import CONTACTS, LOADS, ModesTable
from .positions import Given, Path
from .problems import Report


def loads_of(report: Report) -> tuple[AbstractLoad, ...] | None:
    """Loads of a file; None where something was wrong."""
    given: Given = report.document.get("loads")
    if given is None:
        return (Gravity(),)
    made = [
        _made(("loads", i), table, LOADS, report)
        for i, table in enumerate(given if isinstance(given, list) else ())
    ]
    return None if report.has_below(("loads",)) else tuple(made)


def contact_of(report: Report) -> Rolling | Slipping | None:
    """Contact law of a file; None where something was wrong."""
    table = report.document.get("contact")
    if table is None:
        return Rolling()
    law = _made(("contact",), table, CONTACTS, report)
    if law is None or isinstance(law, Rolling):
        return law
    if isinstance(report.document.get("modes"), dict):
        problem = "has a law of slipping, and where [modes] are theirs alone acts"
        remedy = "leave out [contact], or [modes] if the body slips throughout"
        report.add(("contact",), problem, remedy, at_key=True)
    return Slipping(law)


def modes_of(report: Report) -> Modes | None:
    """How the contact may change; None where it does not, or something was wrong."""
    if not isinstance(report.document.get("modes"), dict):
        return None
    return made_from(("modes",), ModesTable, report)


def _made(
    path: Path, table: Given, known: dict[str, type[DerivedTable]], report: Report
) -> Any:
    """What a table with a kind describes; None where it cannot be made."""
    kind = likely_kind(table, known) if isinstance(table, dict) else None
    return None if kind is None else made_from(path, known[kind], report)
