/* Hand-written peer: Dormand-Prince 5(4) for two rolling problems, final state only.
 *
 * State, 9 numbers: unit quaternion, scalar first, body -> world (4); angular
 * velocity in body axes [rad/s] (3); x and y of the centre of mass [m] (2).
 *
 * With k = R^T e_z the upward vertical in body axes (k' = k x w), n = -k, rho the
 * contact point, V = d rho/dt in body axes and c = r_C - rho:
 *     a_P   = V x w                                      body point at the contact
 *     Th    = I0 + m (|c|^2 1 - c c^T)                   inertia about the contact
 *     Th w' = m c x (-g k - a_P) - w x (Th w)
 *     v_C   = w x c ,  q' = 1/2 q (x) (0, w)
 */
#include <float.h>
#include <math.h>
#include <time.h>

enum { N = 9 };
enum { OK = 0, STEP_TOO_SMALL = 1, TOO_MANY_STEPS = 2, UNKNOWN_PROBLEM = 3 };

#define INLINE static inline __attribute__((always_inline))
typedef void rhs_fn(const double *restrict y, double *restrict d);

#define NUM double
#define ROOT sqrt
#include "rolling_rates.h"

/* Initial step [s] by Hairer, Norsett and Wanner, Solving ODEs I, section II.4. */
INLINE double initial_step(rhs_fn *f, const double *y, const double *k1, double rtol,
                           double atol) {
    double d0 = 0, d1 = 0, d2 = 0, u[N], k[N];
    for (int i = 0; i < N; i++) {
        const double w = 1.0 / (atol + rtol * fabs(y[i]));
        d0 += y[i] * w * y[i] * w;
        d1 += k1[i] * w * k1[i] * w;
    }
    d0 = sqrt(d0 / N), d1 = sqrt(d1 / N);
    const double h0 = d0 < 1e-5 || d1 < 1e-5 ? 1e-6 : 0.01 * d0 / d1;
    for (int i = 0; i < N; i++) u[i] = y[i] + h0 * k1[i];
    f(u, k);
    for (int i = 0; i < N; i++) {
        const double e = (k[i] - k1[i]) / (atol + rtol * fabs(y[i]));
        d2 += e * e;
    }
    d2 = fmax(d1, sqrt(d2 / N) / h0);
    const double h1 = d2 <= 1e-15 ? fmax(1e-6, 1e-3 * h0) : pow(0.01 / d2, 0.2);
    return fmin(100.0 * h0, h1);
}

/* Adaptive DOPRI5 with the first-same-as-last stage and a PI step controller. */
INLINE int dopri5(rhs_fn *f, const double *y0, double t1, double rtol, double atol,
                  double *y_end, long *accepted, long *rejected, long *rhs) {
    const double safety = 0.9, fac_min = 0.2, fac_max = 10.0, beta = 0.04;
    const long max_steps = 100000000;
    double y[N], u[N], k1[N], k2[N], k3[N], k4[N], k5[N], k6[N], k7[N];
    double t = 0, log_old = log(1e-4);
    long n_acc = 0, n_rej = 0, after_reject = 0;
    int status = OK;
    for (int i = 0; i < N; i++) y[i] = y0[i];
    f(y, k1);
    double h = initial_step(f, y, k1, rtol, atol);
    while (t < t1) {
        if (n_acc + n_rej >= max_steps) { status = TOO_MANY_STEPS; break; }
        if (!(h > 4.0 * DBL_EPSILON * t)) { status = STEP_TOO_SMALL; break; }
        const int last = t + 1.01 * h >= t1;
        if (last) h = t1 - t;
        for (int i = 0; i < N; i++) u[i] = y[i] + h * (1.0 / 5 * k1[i]);
        f(u, k2);
        for (int i = 0; i < N; i++)
            u[i] = y[i] + h * (3.0 / 40 * k1[i] + 9.0 / 40 * k2[i]);
        f(u, k3);
        for (int i = 0; i < N; i++)
            u[i] = y[i] + h * (44.0 / 45 * k1[i] - 56.0 / 15 * k2[i] +
                               32.0 / 9 * k3[i]);
        f(u, k4);
        for (int i = 0; i < N; i++)
            u[i] = y[i] + h * (19372.0 / 6561 * k1[i] - 25360.0 / 2187 * k2[i] +
                               64448.0 / 6561 * k3[i] - 212.0 / 729 * k4[i]);
        f(u, k5);
        for (int i = 0; i < N; i++)
            u[i] = y[i] + h * (9017.0 / 3168 * k1[i] - 355.0 / 33 * k2[i] +
                               46732.0 / 5247 * k3[i] + 49.0 / 176 * k4[i] -
                               5103.0 / 18656 * k5[i]);
        f(u, k6);
        for (int i = 0; i < N; i++)
            u[i] = y[i] + h * (35.0 / 384 * k1[i] + 500.0 / 1113 * k3[i] +
                               125.0 / 192 * k4[i] - 2187.0 / 6784 * k5[i] +
                               11.0 / 84 * k6[i]);
        f(u, k7);
        double err = 0; /* mean square of the scaled error */
        for (int i = 0; i < N; i++) {
            const double e = h * (71.0 / 57600 * k1[i] - 71.0 / 16695 * k3[i] +
                                  71.0 / 1920 * k4[i] - 17253.0 / 339200 * k5[i] +
                                  22.0 / 525 * k6[i] - 1.0 / 40 * k7[i]);
            const double s = e / (atol + rtol * fmax(fabs(y[i]), fabs(u[i])));
            err += s * s;
        }
        err *= 1.0 / N;
        const double log_err = 0.5 * log(fmax(err, 1e-30));
        double fac = safety * exp(beta * log_old - (0.2 - 0.75 * beta) * log_err);
        if (err <= 1.0) {
            fac = fmin(fac, after_reject ? 1.0 : fac_max);
            t = last ? t1 : t + h;
            h *= fmax(fac, fac_min);
            for (int i = 0; i < N; i++) y[i] = u[i], k1[i] = k7[i];
            log_old = fmax(log_err, log(1e-4));
            after_reject = 0;
            n_acc++;
        } else {
            h *= err < DBL_MAX ? fmax(safety * exp(-0.17 * log_err), fac_min) : fac_min;
            after_reject = 1;
            n_rej++;
        }
    }
    for (int i = 0; i < N; i++) y_end[i] = y[i];
    *accepted = n_acc, *rejected = n_rej, *rhs = 2 + 6 * (n_acc + n_rej);
    return status;
}

/* Integrate problem 2 (disc) or 3 (rattleback) from 0 to t1 [s]; 0 on success. */
int solve(int problem, const double *y0, double t1, double rtol, double atol,
          double *y_end, long *accepted, long *rejected, long *rhs) {
    switch (problem) {
    case 2:
        return dopri5(rhs_disc, y0, t1, rtol, atol, y_end, accepted, rejected, rhs);
    case 3:
        return dopri5(rhs_rattleback, y0, t1, rtol, atol, y_end, accepted, rejected,
                      rhs);
    default:
        return UNKNOWN_PROBLEM;
    }
}

/* Wall seconds per solve, the mean over `repeats` solves; negative on failure. */
double solve_repeated(int problem, const double *y0, double t1, double rtol,
                      double atol, double *y_end, long *accepted, long *rejected,
                      long *rhs, int repeats) {
    struct timespec a, b;
    int status = OK;
    clock_gettime(CLOCK_MONOTONIC, &a);
    for (int i = 0; i < repeats; i++)
        status |= solve(problem, y0, t1, rtol, atol, y_end, accepted, rejected, rhs);
    clock_gettime(CLOCK_MONOTONIC, &b);
    if (status != OK || repeats < 1) return -1.0;
    return ((b.tv_sec - a.tv_sec) + 1e-9 * (b.tv_nsec - a.tv_nsec)) / repeats;
}

/* Ends of many motions, one after the other; 0 on success. */
int solve_each(int problem, const double *starts, long count, double t1, double rtol,
               double atol, double *ends) {
    long accepted, rejected, rhs;
    int status = OK;
    for (long i = 0; i < count; i++)
        status |= solve(problem, starts + N * i, t1, rtol, atol, ends + N * i, &accepted,
                        &rejected, &rhs);
    return status;
}
