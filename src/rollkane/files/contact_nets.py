"""Tosses of a cube: the records of DAIRLab/contact-nets, as they are distributed.

Each file holds one toss, sampled at 148 Hz: place, orientation, velocity and angular
velocity, in PyTorch's older file format, which is read here without PyTorch.
"""

import collections
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from ..geometry.numpy_rotations import rotated
from ..identification.body_sensors import Gyro
from ..identification.records import Record
from ..identification.sensors import Orientation, Position
from ..validation.checks import FieldError

RATE = 148.0  # samples a second
HALF_WIDTH = 0.0524  # of the cube [m]: places and velocities are in units of it
_MAGIC = 0x1950A86A20F9469CFC6C
_TYPES = {"DoubleStorage": "<f8", "FloatStorage": "<f4"}
_COLUMNS = 19  # place 3, quaternion 4, velocity 3, angular velocity 3, control 6


class Toss(NamedTuple):
    """One toss.

    Attributes:
        time: [s], shape (T,).
        position: Of the cube's middle, FIXED axes [m], shape (T, 3).
        orientation: Quaternions, scalar first, body to fixed axes, shape (T, 4).
        velocity: FIXED axes [m/s], shape (T, 3).
        angular_velocity: BODY axes [rad/s], shape (T, 3).
    """

    time: np.ndarray
    position: np.ndarray
    orientation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray

    @property
    def flight(self) -> slice:
        """Samples before the first contact, without the first and the last two.

        Until a corner of the cube comes as low as the ground.
        """
        corners = HALF_WIDTH * np.array(
            [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float
        )
        turned = rotated(self.orientation[:, None], corners)
        lowest = self.position[:, 2] + turned[..., 2].min(axis=1)
        landed = np.flatnonzero(lowest <= 0.0)
        end = landed[0] if landed.size else self.time.size
        return slice(2, max(int(end) - 2, 2))

    def record(
        self, samples: slice | None = None, sigma: dict[str, float] | None = None
    ) -> Record:
        """Channels ``gyro``, ``position`` and ``orientation`` of some samples.

        Args:
            samples: Which; None: the flight.
            sigma: Deviations by channel; those left out are estimated by a fit.
        """
        kept = self.flight if samples is None else samples
        known = {} if sigma is None else sigma
        channels = {
            "gyro": Gyro(self.angular_velocity[kept], known.get("gyro")),
            "position": Position(self.position[kept], known.get("position")),
            "orientation": Orientation(
                self.orientation[kept], known.get("orientation")
            ),
        }
        return Record(self.time[kept], channels)


def read_toss(path: str | os.PathLike[str]) -> Toss:
    """Read one file of ``data/tosses_processed``.

    Args:
        path: A file with the ending ``.pt``.

    Raises:
        FieldError: another kind of file, or of another shape.
        OSError: the file cannot be read.
    """
    rows = _tensor(Path(path))
    rows = rows[0] if rows.ndim == 3 and rows.shape[0] == 1 else rows
    if rows.ndim != 2 or rows.shape[1] != _COLUMNS or rows.shape[0] < 2:
        problem = f"holds an array of shape {rows.shape}, not (T, {_COLUMNS})"
        raise FieldError("read_toss.path", str(path), problem, "give a toss's file")
    parts = np.split(rows, [3, 7, 10, 13], axis=1)
    time = np.arange(float(rows.shape[0])) / RATE
    return Toss(time, HALF_WIDTH * parts[0], parts[1], HALF_WIDTH * parts[2], parts[3])


class _Storage(NamedTuple):
    """Numbers that follow the pickles of a file, by their key."""

    kind: str
    key: str


class _Reader(pickle.Unpickler):
    """Reads one tensor, and runs nothing else that a file may ask for."""

    def find_class(self, module_name: str, global_name: str, /) -> Callable[..., Any]:
        """What a tensor is made by."""
        if (module_name, global_name) == ("torch._utils", "_rebuild_tensor_v2"):
            return lambda *parts: parts
        if (module_name, global_name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        if module_name == "torch" and global_name in _TYPES:
            return lambda: global_name
        raise pickle.UnpicklingError(f"{module_name}.{global_name} is not a tensor")

    def persistent_load(self, pid: Any, /) -> _Storage:
        """Which numbers are meant."""
        _, kind, key, *_ = pid
        name: object = kind() if callable(kind) else kind
        return _Storage(str(name), str(key))


def _tensor(path: Path) -> np.ndarray:
    """The tensor of a file."""
    try:
        with path.open("rb") as file:
            return _parsed(file)
    except (pickle.UnpicklingError, EOFError, ValueError, TypeError) as error:
        remedy = "give a file of contact-nets' data/tosses_processed"
        raise FieldError("read_toss.path", str(path), "is no toss", remedy) from error


def _parsed(file: IO[bytes]) -> np.ndarray:
    head = [_Reader(file).load() for _ in range(3)]
    if head[0] != _MAGIC:
        raise ValueError("another format")
    storage, offset, shape, strides, *_ = _Reader(file).load()
    keys = _Reader(file).load()
    count = int.from_bytes(file.read(8), "little")
    if [storage.key] != [str(key) for key in keys]:
        raise ValueError("more than one tensor")
    kind = np.dtype(_TYPES[storage.kind])
    numbers = np.frombuffer(file.read(count * kind.itemsize), kind)
    if numbers.size != count:
        raise ValueError("the file is cut short")
    steps = tuple(kind.itemsize * s for s in strides)
    view = np.lib.stride_tricks.as_strided(numbers[offset:], shape, steps)
    return np.array(view, float)
