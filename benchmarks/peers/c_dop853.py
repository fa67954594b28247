"""Peer: hand-written C with DOP853 (Hairer, Norsett, Wanner), its coefficients SciPy's.

The same right-hand sides, clock and calls as ``dopri5.c``.
"""

import ctypes
import tempfile
from pathlib import Path

from . import c_dopri5

STAGES = 12


def source() -> str:
    """``dopri5.c`` with another step, written out."""
    from scipy.integrate._ivp import dop853_coefficients as known

    def weighted(row) -> str:
        terms = [f"{w.hex()} * k[{j}][i]" for j, w in enumerate(row) if w]
        return " + ".join(terms)

    each = "for (int i = 0; i < N; i++)"
    lines = []
    for s in range(1, STAGES):
        row = [float(x) for x in known.A[s, :s]]
        lines.append(f"{each} u[i] = y[i] + h * ({weighted(row)});")
        lines.append(f"f(u, k[{s}]);")
    ends = [[float(x) for x in row] for row in (known.B, known.E5, known.E3)]
    lines.append(f"{each} u[i] = y[i] + h * ({weighted(ends[0])});")
    lines += [
        "double e5 = 0, e3 = 0;",
        f"{each} {{",
        "const double s = 1.0 / (atol + rtol * fmax(fabs(y[i]), fabs(u[i])));",
        f"const double a = s * ({weighted(ends[1])});",
        f"const double b = s * ({weighted(ends[2])});",
        "e5 += a * a, e3 += b * b;",
        "}",
        "const double sum = e5 + 0.01 * e3;",
        "double err = sum > 0 ? h * e5 / sqrt(N * sum) : 0;",
    ]
    text = c_dopri5.SOURCE.read_text()
    first = text.index("/* Adaptive DOPRI5")
    last = text.index("/* Integrate problem 2")
    return text[:first] + LOOP.replace("STEP;", "\n".join(lines)) + text[last:]


# the controller of scipy's, and of the original without its stabilization
LOOP = """
INLINE int dopri5(rhs_fn *f, const double *y0, double t1, double rtol, double atol,
                  double *y_end, long *accepted, long *rejected, long *rhs) {
    double y[N], u[N], k[12][N], t = 0;
    long n_acc = 0, n_rej = 0, after_reject = 0;
    int status = OK;
    for (int i = 0; i < N; i++) y[i] = y0[i];
    f(y, k[0]);
    double h = initial_step(f, y, k[0], rtol, atol);
    while (t < t1) {
        if (!(h > 4.0 * DBL_EPSILON * t)) { status = STEP_TOO_SMALL; break; }
        const int last = t + 1.01 * h >= t1;
        if (last) h = t1 - t;
        STEP;
        double fac = 0.9 * pow(fmax(err, 1e-30), -0.125);
        if (err <= 1.0) {
            t = last ? t1 : t + h;
            h *= fmin(fmax(fac, 0.333), after_reject ? 1.0 : 6.0);
            for (int i = 0; i < N; i++) y[i] = u[i];
            f(y, k[0]);
            after_reject = 0, n_acc++;
        } else {
            h *= err < DBL_MAX ? fmax(fac, 0.333) : 0.333;
            after_reject = 1, n_rej++;
        }
    }
    for (int i = 0; i < N; i++) y_end[i] = y[i];
    *accepted = n_acc, *rejected = n_rej, *rhs = 2 + 11 * (n_acc + n_rej) + n_acc;
    return status;
}

"""


def load() -> tuple[c_dopri5.CPeer | None, str]:
    """Compile and load the peer; return it and "", or None and the reason."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        text, target = Path(folder, "dop853.c"), Path(folder, "dop853.so")
        rates = c_dopri5.SOURCE.with_name("rolling_rates.h")
        Path(folder, rates.name).write_text(rates.read_text())
        text.write_text(source())
        shown, reason = c_dopri5.compiled(text, target)
        if not shown:
            return None, reason
        library = c_dopri5.declared(ctypes.CDLL(str(target)))
        return c_dopri5.CPeer(library, shown), ""
