/* Hand-vectorised peer: eight motions of P2 or P3 side by side, each at its own steps.
 *
 * Dormand-Prince 5(4) as in dopri5.c, on the compiler's vectors of eight doubles; a lane
 * that ends takes the next motion of the queue.
 */
#include <math.h>

enum { N = 9, W = 8 };
typedef double row __attribute__((vector_size(8 * W)));
typedef long long mask __attribute__((vector_size(8 * W)));
#define INLINE static inline __attribute__((always_inline))

INLINE row root_row(row x) {
    row r;
    for (int l = 0; l < W; l++) r[l] = sqrt(x[l]);
    return r;
}
INLINE row pick(mask m, row a, row b) { return (row)((m & (mask)a) | (~m & (mask)b)); }
INLINE row larger(row a, row b) { return pick(a > b, a, b); }
INLINE row smaller(row a, row b) { return pick(a < b, a, b); }
INLINE row size_of(row a) { return larger(a, -a); }

#define NUM row
#define ROOT root_row
#include "rolling_rates.h"

/* x^(-1/5) within 1 %, which is all that a step size needs */
INLINE row fifth_root(row x) {
    const row bits = __builtin_convertvector((mask)x, row);
    row r = (row)__builtin_convertvector(1.2 * 0x3FF0000000000000LL - 0.2 * bits, mask);
    for (int k = 0; k < 3; k++) r *= 1.2 - 0.2 * x * r * r * r * r * r;
    return r;
}

#define EACH for (int i = 0; i < N; i++)

/* Integrate `count` motions from 0 to t1; returns the steps tried, -1 on failure. */
INLINE long integrate(void (*f)(const row *restrict, row *restrict), const double *starts,
                      long count, double t1, double rtol, double atol, double *ends) {
    row y[N] = {{0}}, u[N], k1[N], k2[N], k3[N], k4[N], k5[N], k6[N], k7[N];
    row t = (row){0} + t1, h = {0};
    long motion[W], ahead = 0, tried = 0, left = 0;
    for (int l = 0; l < W; l++) motion[l] = -1;
    for (;;) {
        for (int l = 0; l < W; l++) { /* ended: write, and take the next */
            if (t[l] < t1) continue;
            if (motion[l] >= 0) {
                EACH ends[motion[l] * N + i] = y[i][l];
                motion[l] = -1, left--;
            }
            if (ahead >= count) continue;
            motion[l] = ahead++, left++;
            EACH y[i][l] = starts[motion[l] * N + i];
            t[l] = 0, h[l] = 1e-3;
        }
        if (!left) return tried;
        f(y, k1);
        for (int ended = 0; !ended;) {
            h = smaller(h, t1 - t);
            EACH u[i] = y[i] + h * (1.0 / 5 * k1[i]);
            f(u, k2);
            EACH u[i] = y[i] + h * (3.0 / 40 * k1[i] + 9.0 / 40 * k2[i]);
            f(u, k3);
            EACH u[i] = y[i] + h * (44.0 / 45 * k1[i] - 56.0 / 15 * k2[i] +
                                    32.0 / 9 * k3[i]);
            f(u, k4);
            EACH u[i] = y[i] + h * (19372.0 / 6561 * k1[i] - 25360.0 / 2187 * k2[i] +
                                    64448.0 / 6561 * k3[i] - 212.0 / 729 * k4[i]);
            f(u, k5);
            EACH u[i] = y[i] + h * (9017.0 / 3168 * k1[i] - 355.0 / 33 * k2[i] +
                                    46732.0 / 5247 * k3[i] + 49.0 / 176 * k4[i] -
                                    5103.0 / 18656 * k5[i]);
            f(u, k6);
            EACH u[i] = y[i] + h * (35.0 / 384 * k1[i] + 500.0 / 1113 * k3[i] +
                                    125.0 / 192 * k4[i] - 2187.0 / 6784 * k5[i] +
                                    11.0 / 84 * k6[i]);
            f(u, k7);
            row size = {0};
            EACH {
                const row e = h * (71.0 / 57600 * k1[i] - 71.0 / 16695 * k3[i] +
                                   71.0 / 1920 * k4[i] - 17253.0 / 339200 * k5[i] +
                                   22.0 / 525 * k6[i] - 1.0 / 40 * k7[i]);
                const row s = e / (atol + rtol * larger(size_of(y[i]), size_of(u[i])));
                size += s * s;
            }
            size = root_row(size * (1.0 / N));
            const mask kept = size < 1.0;
            EACH y[i] = pick(kept, u[i], y[i]), k1[i] = pick(kept, k7[i], k1[i]);
            const mask last = kept & (h >= t1 - t);
            t = pick(last, (row){0} + t1, pick(kept, t + h, t));
            const row most = pick(kept, (row){0} + 10.0, (row){0} + 0.9);
            const row x = larger(smaller(size, (row){0} + 1e6), (row){0} + 1e-6);
            h *= larger(smaller(0.9 * fifth_root(x), most), (row){0} + 0.2);
            tried += left;
            for (int l = 0; l < W; l++) {
                if (motion[l] >= 0 && !(t[l] < t1)) ended = 1;
                if (motion[l] >= 0 && !(h[l] > 1e-14) && t[l] < t1) return -1;
            }
        }
    }
}

/* Problem 2 (disc) or 3 (rattleback). */
long solve_lanes(int problem, const double *starts, long count, double t1, double rtol,
                 double atol, double *ends) {
    if (problem == 2) return integrate(rhs_disc, starts, count, t1, rtol, atol, ends);
    return integrate(rhs_rattleback, starts, count, t1, rtol, atol, ends);
}
