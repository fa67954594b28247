"""Tables of samples: columns by name, from CSV, NetCDF or a data frame."""

import csv
import difflib
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from jaxtyping import Float

from ..validation.checks import FieldError
from .accelerogram_lines import MANY_ALIKE, Lines
from .csv_table import axes_of
from .file_endings import NETCDF, ending

READER = "read_record"
_MISSING = {"", "nan"}  # cells without a sample, in any case
# kinds of arrays whose numbers are none of samples
_SPAN = "dates or spans of time"
_STRANGE = {"c": "complex numbers", "m": _SPAN, "M": _SPAN}
_SEPARATORS = "\t;,"  # that which the header has first of these separates cells
# a column's name that ends in its unit: "wx [deg/s]", "ax (g)"
_NAMED_UNIT = re.compile(r".+?[\s_]*(?:\[\s*([^][]+?)\s*\]|\(\s*([^()]+?)\s*\))$")
# what a name ends in, behind a mark: "x_cm", "w deg/s"
_END = re.compile(r".*[\s_]([^\s_]+)$")


class About(NamedTuple):
    """What a table says of a column besides its samples; None: nothing.

    Attributes:
        unit: Its unit, or that in its name.
        along: What its rows are over, where columns differ in it.
        axes: That its numbers are on.
    """

    unit: str | None = None
    along: str | None = None
    axes: str | None = None


class Table(NamedTuple):
    """Columns of samples.

    Attributes:
        source: Its name, for messages.
        names: Of the columns, in order.
        cells: ``cells(name)`` -> a column's cells, of any type.
        row: ``row(k)`` -> what row k is called, for messages.
        about: What else is known of columns, by name.
    """

    source: str
    names: tuple[str, ...]
    cells: Callable[[str], Sequence[Any]]
    row: Callable[[int], str]
    about: dict[str, About]

    def refuse(self, field: str, value: Any, problem: str, remedy: str) -> NoReturn:
        """Raise, naming the source."""
        name = f"{READER}.{field}"
        raise FieldError(name, value, f"{self.source}: {problem}", remedy)

    def column(
        self, field: str, name: str, beside: str | None = None
    ) -> Float[np.ndarray, " T"]:
        """A column of numbers, NaN where a cell is missing.

        Args:
            field: Argument that asks for it.
            name: Of the column.
            beside: Another column, whose rows must be the same.

        Raises:
            FieldError: no such column, or two of the name; cells that are not numbers;
                rows of another clock.
        """
        if self.names.count(name) != 1:
            known = ", ".join(self.names)
            if name in self.names:
                remedy = f"rename one of them; the columns are: {known}"
                self.refuse(field, name, f"has two columns {name!r}", remedy)
            near = difflib.get_close_matches(name, self.names, n=1, cutoff=0.5)
            meant = f"did you mean {near[0]!r}? " if near else ""
            remedy = f"{meant}the columns are: {known}"
            self.refuse(field, name, f"has no column {name!r}", remedy)
        if beside is not None:
            self._check_rows(field, name, beside)
        cells = self.cells(name)
        strange = _STRANGE.get(getattr(getattr(cells, "dtype", None), "kind", ""))
        if strange is not None:
            problem = f"column {name!r} holds {strange}"
            self.refuse(field, name, problem, "give real numbers, times in seconds")
        try:
            numbers = np.asarray(cells, float)
        except (TypeError, ValueError):
            numbers = np.array(
                [self._number(k, name, cell) for k, cell in enumerate(cells)], float
            )
        if np.isinf(numbers).any():
            self._refuse_cell(int(np.argmax(np.isinf(numbers))), name, "inf")
        return numbers

    def _check_rows(self, field: str, name: str, beside: str) -> None:
        own, other = self.of(name).along, self.of(beside).along
        if own != other:
            problem = f"has {name!r} over {own!r}, and {beside!r} over {other!r}"
            remedy = "take columns over one and the same, each clock as its own record"
            self.refuse(field, name, problem, remedy)

    def of(self, name: str) -> About:
        """What is known of a column."""
        return self.about.get(name, About())

    def _number(self, row: int, name: str, cell: Any) -> float:
        if cell is None or str(cell).strip().lower() in _MISSING:
            return np.nan
        try:
            return float(cell)
        except (TypeError, ValueError):
            self._refuse_cell(row, name, cell)

    def _refuse_cell(self, row: int, name: str, cell: Any) -> NoReturn:
        problem = f"{self.row(row)}, column {name!r}: is not a number"
        remedy = "write decimal points; leave cells of missing samples empty"
        self.refuse("path", cell, problem, remedy)


def table_of(source: Any) -> Table:
    """The table of a file, by its name, or of a data frame.

    Args:
        source: Path of a CSV file (comma, semicolon or tab; a header row; comments
            behind #) or of a NetCDF file (``.nc``, ``.nc4``, ``.h5``, ``.hdf5``);
            or anything with ``columns``.

    Raises:
        FieldError: it cannot be read, or has no rows.
        ImportError: a NetCDF file, without xarray.
    """
    if hasattr(source, "columns"):
        return _of_frame(source)
    if ending(source) in NETCDF:
        return _of_netcdf(source)
    return _of_csv(source)


def _of_csv(path: str | os.PathLike[str]) -> Table:
    file = Lines(READER, path)
    whole = file.lines
    numbers = [
        k
        for k, line in enumerate(whole)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(numbers) < 2:
        remedy = "give names in the first row, and samples below"
        file.refuse(None, "has no rows of samples", remedy)
    header = whole[numbers[0]]
    separator = next((mark for mark in _SEPARATORS if mark in header), ",")
    rows = list(csv.reader((whole[k] for k in numbers), delimiter=separator))
    if len(rows) != len(numbers):
        file.refuse(None, "has a quote that goes on in the next line", "mend it")
    names = tuple(name.strip() for name in rows[0])
    if all(_is_number(name) for name in names):
        remedy = "write the columns' names into its first row"
        file.refuse(numbers[0], "has numbers where the header should be", remedy)
    for k, row in zip(numbers, rows, strict=True):
        if len(row) != len(names):
            problem = f"has {len(row)} cells below {len(names)} names"
            file.refuse(k, problem, "mend the row")
    if numbers[-1] == len(whole) - 1:  # no comment is behind it
        file.check_end([row[-1] for row in rows[1:]], MANY_ALIKE)

    def cells(name: str) -> list[str]:
        k = names.index(name)
        return [row[k] for row in rows[1:]]

    return Table(
        source=str(path),
        names=names,
        cells=cells,
        row=lambda k: f"line {numbers[k + 1] + 1}",
        about=_by_names(names),
    )


def _by_names(names: Sequence[str]) -> dict[str, About]:
    """Units in brackets behind names of columns, and axes of those of a run's table."""
    axes = {name: About(axes=own) for name, own in axes_of(names).items()}
    found = ((name, _NAMED_UNIT.match(name)) for name in names)
    return axes | {name: About(m[1] or m[2]) for name, m in found if m is not None}


def end_of_name(name: str) -> str:
    """What a column's name ends in, which may be a unit; empty: in nothing."""
    end = _END.match(name)
    return "" if end is None else end[1]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _of_netcdf(path: str | os.PathLike[str]) -> Table:
    """Variables of one dimension; of two, ``name_label`` for each of the second's."""
    try:
        import xarray
    except ImportError as error:
        raise ImportError(
            "NetCDF files need xarray: pip install 'rollkane[results]'"
        ) from error
    columns: dict[str, Any] = {}
    about: dict[str, About] = {}
    try:
        # times and spans of time stay numbers
        with xarray.open_dataset(Path(path), decode_times=False) as data:
            for name, variable in data.variables.items():
                for label, values in _parts(data, variable):
                    columns[f"{name}{label}"] = values
                    known = (variable.attrs.get(x) for x in ("units", "axes"))
                    unit, axes = (None if x is None else str(x) for x in known)
                    along = str(variable.dims[0])
                    about[f"{name}{label}"] = About(unit, along, axes or None)
    except (OSError, ValueError) as error:
        field, remedy = f"{READER}.path", "give the path of a NetCDF file"
        raise FieldError(
            field, str(path), f"cannot be read: {error}", remedy
        ) from error
    return _of_columns(str(path), columns, about)


def _parts(data: Any, variable: Any) -> list[tuple[str, np.ndarray]]:
    values = np.asarray(variable.values)
    if values.ndim == 1:
        return [("", values)]
    if values.ndim != 2:
        return []
    second = variable.dims[1]
    labels = data[second].values if second in data.coords else range(values.shape[1])
    return [(f"_{label}", values[:, k]) for k, label in enumerate(labels)]


def _of_frame(frame: Any) -> Table:
    names = [str(name) for name in frame.columns]
    given = zip(names, frame.columns, strict=True)
    # of two columns of a name neither is read
    columns = {
        name: np.asarray(frame[key]) for name, key in given if names.count(name) == 1
    }
    table = _of_columns("the data frame", columns, _by_names(names))
    return table._replace(names=tuple(names))


def _of_columns(source: str, columns: dict[str, Any], about: dict[str, About]) -> Table:
    if not any(len(cells) for cells in columns.values()):
        problem, remedy = f"{source}: has no rows of samples", "give one with samples"
        raise FieldError(f"{READER}.path", source, problem, remedy)
    return Table(
        source, tuple(columns), columns.__getitem__, lambda k: f"row {k}", about
    )
