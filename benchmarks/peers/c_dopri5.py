"""Peer: hand-written C with DOPRI5, compiled on the spot and loaded by ctypes."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

from .problems import INITIAL, PROBLEMS, PeerResult

SOURCE = Path(__file__).with_name("dopri5.c")
FLAGS = (
    ("-O3", "-march=native"),
    ("-O3", "-mcpu=native"),
    ("-O3",),
)
_NUMBER = {"P2": 2, "P3": 3}
_STATUS = {
    1: "the step became too small",
    2: "too many steps",
    3: "unknown problem",
}
_Vector = ctypes.c_double * 9


class CPeer(NamedTuple):
    """The loaded library and how it was compiled."""

    library: ctypes.CDLL
    command: str

    def _arguments(self, name: str, rtol: float, atol: float) -> tuple:
        """Return the arguments of `solve`: inputs, then the four outputs."""
        return (
            _NUMBER[name],
            _Vector(*INITIAL[name]),
            PROBLEMS[name]["t_end"],
            rtol,
            atol,
            _Vector(),
            ctypes.c_long(),
            ctypes.c_long(),
            ctypes.c_long(),
        )

    def solve(self, name: str, rtol: float, atol: float) -> PeerResult:
        """Integrate a problem to its end; raise RuntimeError when it fails."""
        arguments = self._arguments(name, rtol, atol)
        status = self.library.solve(*arguments)
        if status:
            raise RuntimeError(f"C DOPRI5, {name}: {_STATUS.get(status, status)}")
        end, accepted, rejected, rhs = arguments[5:]
        return PeerResult(list(end), accepted.value, rejected.value, rhs.value)

    def solve_each(self, name: str, starts, end: float, rtol: float, atol: float):
        """Ends of many motions, one after the other; the loop is in C."""
        count = len(starts)
        numbers = (ctypes.c_double * (9 * count))(*starts.reshape(-1))
        ends = (ctypes.c_double * (9 * count))()
        arguments = (ctypes.c_double(x) for x in (end, rtol, atol))
        status = self.library.solve_each(
            _NUMBER[name], numbers, ctypes.c_long(count), *arguments, ends
        )
        if status:
            raise RuntimeError(f"C DOPRI5, {name}: {_STATUS.get(status, status)}")
        return ends

    def seconds(
        self, name: str, rtol: float, atol: float, repeats: int, samples: int
    ) -> list[float]:
        """Return `samples` wall times per solve [s], each a mean over `repeats`.

        The clock is read in C, so that nothing of Python is timed.
        """
        arguments = self._arguments(name, rtol, atol)
        times = [
            self.library.solve_repeated(*arguments, repeats) for _ in range(samples)
        ]
        if min(times) < 0.0:
            raise RuntimeError(f"C DOPRI5, {name}: the timed solve failed")
        return times


def compiled(source: Path, target: Path, more: tuple = ()) -> tuple[str, str]:
    """Compile to a library; return the command as shown, or "" and the reason."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        return "", "no C compiler found (tried cc, gcc, clang)"
    reason = ""
    for flags in FLAGS:
        head = [compiler, "-std=gnu11", *flags, *more, "-fPIC", "-shared"]
        command = [*head, str(source), "-o", str(target), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return " ".join([Path(compiler).name, *head[1:]]), ""
        reason = done.stderr.strip()
    return "", f"the C compiler failed: {reason}"


def load() -> tuple[CPeer | None, str]:
    """Compile and load the peer; return it and "", or None and the reason."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        target = Path(folder) / "dopri5.so"
        shown, reason = compiled(SOURCE, target)
        if not shown:
            return None, reason
        try:
            return CPeer(declared(ctypes.CDLL(str(target))), shown), ""
        except OSError as error:
            return None, f"the compiled library does not load: {error}"


def declared(library: ctypes.CDLL) -> ctypes.CDLL:
    """Declare the two entry points of dopri5.c."""
    double, long = ctypes.c_double, ctypes.POINTER(ctypes.c_long)
    shared = [ctypes.c_int, _Vector, *[double] * 3, _Vector, long, long, long]
    library.solve.argtypes = shared
    library.solve.restype = ctypes.c_int
    library.solve_repeated.argtypes = [*shared, ctypes.c_int]
    library.solve_repeated.restype = double
    return library
