"""Tables of what acts on the body, and of what its contact does."""

from typing import Annotated, Literal

from pydantic import Field

from .derived_tables import table_of, tables_of

LOADS = tables_of(
    {
        "gravity": ("Uniform gravity.", "dynamics.loads.Gravity"),
        "drag": (
            "Resistance of the air, on a point of the body and on its turning.",
            "dynamics.loads.Drag",
        ),
        "rolling-resistance": (
            "A moment against rolling.",
            "dynamics.resistance.RollingResistance",
        ),
        "spinning-resistance": (
            "A moment against turning about the normal.",
            "dynamics.resistance.SpinningResistance",
        ),
    }
)
CONTACTS = tables_of(
    {
        "rolling": (
            "Rolling without slipping, turning about the normal allowed.",
            "dynamics.scene.Rolling",
        ),
        "rubber": (
            "Rolling without slipping and without turning about the normal.",
            "dynamics.scene.RubberRolling",
        ),
        "viscous": (
            "Slipping on a film of oil.",
            "dynamics.friction.ViscousFriction",
        ),
        "coulomb": (
            "Slipping against dry friction.",
            "dynamics.friction.CoulombFriction",
        ),
        "stribeck": (
            "Slipping against friction that falls with the speed.",
            "dynamics.friction.StribeckFriction",
        ),
    }
)
ModesTable = table_of(
    "ModesTable",
    "How the run may change between rolling, slipping and flight.",
    "hybrid.modes.Modes",
    narrower={
        "switches": Annotated[int, Field(ge=1)],
        "impact": Literal["energetic", "newton"],
    },
)
