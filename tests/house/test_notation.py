"""docs/notation.md is true: every name in it is in the code, with its unit."""

import inspect
import re
from pathlib import Path

import rollkane as rk
from rollkane.dynamics import bodies, contact_laws
from rollkane.dynamics.carried import Carried, Turning
from rollkane.dynamics.mass_matrix import System
from rollkane.kinematics import contact
from rollkane.kinematics.base_motion import BaseKinematics
from rollkane.kinematics.voronets import ChartContact
from rollkane.paper import quasi_energy

TABLE = (Path(__file__).parents[2] / "docs" / "notation.md").read_text()
OWNERS = {
    "KaneEquations": rk.kane.KaneEquations,
    "KaneState": rk.kane.KaneState,
    "LocalGeometry": rk.LocalGeometry,
    "BaseKinematics": BaseKinematics,
    "Carried": Carried,
    "ChartContact": ChartContact,
    "Contact": contact.Contact,
    "Inertia": quasi_energy.Inertia,
    "PaperQuantities": rk.PaperQuantities,
    "PointMasses": rk.PointMasses,
    "System": System,
    "Turning": Turning,
    "VoronetsState": rk.VoronetsState,
    "quasi_energy": quasi_energy,
    "SlidingState": rk.SlidingState,
    "Solution": contact_laws.Solution,
    "State": rk.State,
    "Trajectory": rk.Trajectory,
    "bodies": bodies,
}


def rows():
    lines = [line for line in TABLE.splitlines() if line.startswith("| ")][1:]
    for line in lines:
        _, name, _, unit, *_ = (cell.strip() for cell in line.strip("|").split("|"))
        unit = unit.replace("²", "^2").replace("³", "^3")  # as docstrings have them
        for owner, attribute in re.findall(r"`(\w+)\.(\w+)`", name):
            yield owner, attribute, unit


def test_every_name_is_in_the_code():
    found = list(rows())
    assert len(found) > 70
    for owner, attribute, _ in found:
        thing = OWNERS[owner]
        fields = getattr(thing, "__dataclass_fields__", {})
        assert hasattr(thing, attribute) or attribute in fields, (owner, attribute)


def test_every_name_is_documented_with_its_unit():
    for owner, attribute, unit in rows():
        text = inspect.getdoc(OWNERS[owner]) or ""
        own = inspect.getdoc(getattr(OWNERS[owner], attribute, None)) or ""
        assert attribute in text or own
        first = unit.split(" per")[0]
        if first:
            assert re.search(rf"\[{re.escape(first)}", text + own), (attribute, unit)
