"""Tables of a scene file: every field of a constructor has its place in them."""

import inspect

import pytest

import rollkane as rk
from rollkane.files.scene_files.derived_tables import table_of
from rollkane.files.scene_files.load_tables import CONTACTS, LOADS, ModesTable
from rollkane.files.scene_files.moving_tables import MOTIONS, SUPPORTED, RecordTable
from rollkane.files.scene_files.surface_tables import SURFACES
from rollkane.files.scene_files.tables import (
    BaseTable,
    BodyTable,
    RollingTable,
    SceneTable,
    StartTable,
)

# Fields of a file that stand for an argument of another name.
INSTEAD = {
    "Revolution": {"profile": {"radius", "height"}},
    "Parametric": {"position": {"x", "y", "z"}},
    "BaseMotion": {"rotation": {"rotations"}},
    "SupportedBody": {"rotation": {"rotations"}},
    "RecordedMotion": {"time": {"record", "file"}, "acceleration": {"record", "file"}},
    # states of rolling bodies stand in their own tables
    "place": {"scene": set(), "velocity": {"slip"}, "supported": set()},
    "RollingBody": {
        "supported": {"carrier"},
        "contact": {"without_spin"},
        "rotation": {"rotations"},
    },
}
# Arguments that a file cannot give, and needs not.
NOT_IN_FILES = {
    "Revolution": {"poles", "rising"},  # found by evaluation
    "Parametric": {"of_direction"},  # formulas are of a pair
    "BaseMotion": {"kinks"},  # formulas have none
    "Scene": {"kinks"},
    "RollingBody": {"torque", "parameters"},  # no formulas of a state
    "place": {"time"},  # runs of files begin at 0
}
OTHERS = {
    rk.Body: BodyTable,
    rk.Base: BaseTable,
    rk.Scene: SceneTable,
    rk.Modes: ModesTable,
    rk.RecordedMotion: RecordTable,
    rk.place: StartTable,
    rk.RollingBody: RollingTable,
}
TABLES = OTHERS | {
    table.made_by(): table
    for tables in (SURFACES, LOADS, CONTACTS, MOTIONS, SUPPORTED)
    for table in tables.values()
    if table is not RecordTable
}


@pytest.mark.parametrize("make", TABLES, ids=lambda make: make.__name__)
def test_every_argument_has_a_place(make):
    instead = INSTEAD.get(make.__name__, {})
    known = inspect.signature(make).parameters
    absent = NOT_IN_FILES.get(make.__name__, set())
    assert absent <= set(known)
    for name in set(known) - absent:
        assert instead.get(name, {name}) <= set(TABLES[make].model_fields), name


def test_every_class_of_the_catalogue_is_there():
    """Surfaces and laws of friction that are public."""
    kinds = rk.geometry.surfaces.AbstractSurface, rk.dynamics.friction.AbstractFriction
    public = {getattr(rk, name) for name in rk.__all__}
    found = {x for x in public if inspect.isclass(x) and issubclass(x, kinds)}
    assert len(found) > 10
    assert found <= set(TABLES)


def test_what_a_file_cannot_give_needs_something_instead():
    with pytest.raises(TypeError, match=r"argument f of .*Graph"):
        table_of("GraphTable", "", "geometry.surfaces.user_surfaces.Graph")
