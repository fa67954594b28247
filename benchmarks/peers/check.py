"""Self-check of the peers: `python benchmarks/peers/check.py`.

Prints the errors against the reference, the steps and the median wall time per solve,
and ends with status 1 when a peer misses the reference at the tightest tolerance.
"""

import statistics
import sys
import timeit
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from peers import c_dopri5, scipy_dop853
from peers.problems import INITIAL, PROBLEMS, PeerResult, end_error

TOLERANCES = (1e-8, 1e-10, 1e-12)
ATOL_PER_RTOL = 1e-2
LIMIT = 1e-9  # largest position [m] and rotation [rad] error at the tightest tolerance
SAMPLES_C, REPEATS_C, SAMPLES_SCIPY = 15, 10, 5

HEADER = (
    "problem  peer          rtol   position m  rotation rad     energy"
    "   time ms  accepted  rejected     rhs  us/step"
)


def report(
    name: str, peer: str, rtol: float, result: PeerResult, times: list[float]
) -> bool:
    """Print one row of the table; return whether the errors are acceptable."""
    error = end_error(PROBLEMS[name], result.y_end)
    seconds = statistics.median(times)
    print(
        f"{name:7s}  {peer:12s} {rtol:5.0e}  {error.position:10.2e}"
        f"  {error.rotation:12.2e}  {error.energy:9.1e}  {1e3 * seconds:8.3f}"
        f"  {result.accepted:8d}  {result.rejected:8d}  {result.rhs:6d}"
        f"  {1e6 * seconds / result.accepted:7.3f}"
    )
    tightest = rtol == min(TOLERANCES)
    return not tightest or max(error.position, error.rotation) < LIMIT


def python_styles() -> str:
    """Compare the two Python styles of the P3 right-hand side: times and agreement."""
    y = np.array(INITIAL["P3"])
    scalars = scipy_dop853.RHS["P3"]
    arrays = scipy_dop853.rhs_arrays(PROBLEMS["P3"])
    difference = np.abs(np.array(scalars(0.0, y)) - arrays(0.0, y)).max()
    times = [
        statistics.median(timeit.repeat(lambda f=f: f(0.0, y), number=500, repeat=9))
        for f in (scalars, arrays)
    ]
    fast, slow = (1e6 * t / 500 for t in times)
    return (
        f"P3 right-hand side in Python: {fast:.1f} us with scalars, {slow:.1f} us with "
        f"small arrays; largest difference {difference:.1e}"
    )


def main() -> int:
    """Print the table; return 0 when every peer meets the reference."""
    peer, reason = c_dopri5.load()
    print(peer.command if peer else f"C peer left out: {reason}")
    print(HEADER)
    good = True
    for name in PROBLEMS:
        for rtol in TOLERANCES:
            atol = ATOL_PER_RTOL * rtol
            if peer is not None:
                result = peer.solve(name, rtol, atol)
                times = peer.seconds(name, rtol, atol, REPEATS_C, SAMPLES_C)
                good &= report(name, "C DOPRI5", rtol, result, times)
            result = scipy_dop853.solve(name, rtol, atol)
            times = scipy_dop853.seconds(name, rtol, atol, SAMPLES_SCIPY)
            good &= report(name, "SciPy DOP853", rtol, result, times)
    print(python_styles())
    print("all peers meet the reference" if good else "A PEER MISSES THE REFERENCE")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
