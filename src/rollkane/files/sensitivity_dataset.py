"""Sensitivities as a labelled dataset."""

from typing import TYPE_CHECKING

from ..identification.sensitivity import Sensitivity

if TYPE_CHECKING:
    import xarray


def sensitivity_dataset(found: Sensitivity) -> "xarray.Dataset":
    """Observables, and ``d(observable)/d(path)`` with the numbers' names, by time."""
    import xarray

    variables: dict[str, object] = {}
    coordinates: dict[str, object] = {"time": ("time", found.time, {"units": "s"})}
    for name, value in found.observed.items():
        own = tuple(f"{name}_{k}" for k in range(value.ndim - 1))
        variables[name] = (("time", *own), value)
        for path, slope in found.values[name].items():
            numbers = f"{path}_number"
            coordinates[numbers] = (numbers, list(found.names[path]))
            variables[f"d({name})/d({path})"] = (("time", *own, numbers), slope)
    return xarray.Dataset(variables, coordinates)
