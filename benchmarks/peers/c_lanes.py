"""Peer: hand-vectorised C, eight motions side by side, loaded by ctypes."""

import ctypes
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from . import c_dopri5

SOURCE = Path(__file__).with_name("dopri5_lanes.c")
_NUMBER = {"P2": 2, "P3": 3}


class LanesPeer(NamedTuple):
    """The loaded library."""

    library: ctypes.CDLL

    def solve(self, name: str, starts, end: float, rtol: float, atol: float):
        """Ends of many motions, shape (M, 9); raise RuntimeError when one fails."""
        starts = np.ascontiguousarray(starts, float)
        ends = np.empty_like(starts)
        address = lambda x: x.ctypes.data_as(ctypes.c_void_p)
        tried = self.library.solve_lanes(
            _NUMBER[name],
            address(starts),
            ctypes.c_long(len(starts)),
            *(ctypes.c_double(x) for x in (end, rtol, atol)),
            address(ends),
        )
        if tried < 0:
            raise RuntimeError(f"C lanes, {name}: the step became too small")
        return ends


def load() -> tuple[LanesPeer | None, str]:
    """Compile and load the peer; return it and "", or None and the reason."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        target = Path(folder) / "lanes.so"
        command, reason = c_dopri5.compiled(SOURCE, target, ("-fno-math-errno",))
        if not command:
            return None, reason
        library = ctypes.CDLL(str(target))
    library.solve_lanes.restype = ctypes.c_long
    return LanesPeer(library), ""
