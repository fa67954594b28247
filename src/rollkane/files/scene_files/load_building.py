"""From checked tables to loads, the contact law, and how the contact may change."""

from collections.abc import Callable
from typing import Any

from ...dynamics.friction import CoulombFriction, StribeckFriction, ViscousFriction
from ...dynamics.loads import AbstractLoad, Drag, Gravity
from ...dynamics.resistance import RollingResistance, SpinningResistance
from ...dynamics.scene import Rolling, RubberRolling, Slipping
from ...hybrid.modes import Modes
from .checking import likely_kind
from .construction import attempt, noting, usable
from .load_tables import CONTACTS, LOADS, ModesTable
from .positions import Given, Path
from .problems import Report
from .table_types import Table

_LOADS = {
    "gravity": Gravity,
    "drag": Drag,
    "rolling-resistance": RollingResistance,
    "spinning-resistance": SpinningResistance,
}
_LAWS = {
    "rolling": Rolling,
    "rubber": RubberRolling,
    "viscous": ViscousFriction,
    "coulomb": CoulombFriction,
    "stribeck": StribeckFriction,
}


def loads_of(report: Report) -> tuple[AbstractLoad, ...] | None:
    """Loads of a file; None where something was wrong."""
    given: Given = report.document.get("loads")
    if given is None:
        return (Gravity(),)
    made = [
        _made(("loads", i), table, LOADS, _LOADS, report)
        for i, table in enumerate(given if isinstance(given, list) else ())
    ]
    return None if report.has_below(("loads",)) else tuple(made)


def contact_of(report: Report) -> Rolling | Slipping | None:
    """Contact law of a file; None where something was wrong."""
    table = report.document.get("contact")
    if table is None:
        return Rolling()
    law = _made(("contact",), table, CONTACTS, _LAWS, report)
    if law is None or report.has_below(("contact",)):
        return None
    return law if isinstance(law, Rolling) else Slipping(law)


def modes_of(report: Report) -> Modes | None:
    """How the contact may change; None where it does not, or something was wrong."""
    if not isinstance(report.document.get("modes"), dict):
        return None
    fields = tuple(ModesTable.model_fields)
    arguments = usable(("modes",), fields, (), report)
    return attempt(Modes, arguments, noting(("modes",), fields, report))


def _made(
    path: Path,
    table: Given,
    known: dict[str, type[Table]],
    makers: dict[str, Callable[..., Any]],
    report: Report,
) -> Any:
    """What a table with a kind describes; None where it cannot be made."""
    kind = likely_kind(table, known) if isinstance(table, dict) else None
    if kind is None:
        return None
    fields = known[kind].model_fields
    names = tuple(name for name in fields if name != "kind")
    required = [name for name in names if fields[name].is_required()]
    arguments = usable(path, names, required, report)
    return attempt(makers[kind], arguments, noting(path, names, report))
