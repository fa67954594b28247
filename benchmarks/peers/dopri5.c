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

static const double G = 9.81; /* [m/s^2] */

/* q' and the horizontal velocity of the centre of mass, from v_C in body axes [m/s]. */
INLINE void kinematics(const double *restrict y, double vx, double vy, double vz,
                       double *restrict d) {
    const double q0 = y[0], q1 = y[1], q2 = y[2], q3 = y[3];
    const double wx = 0.5 * y[4], wy = 0.5 * y[5], wz = 0.5 * y[6];
    d[0] = -q1 * wx - q2 * wy - q3 * wz;
    d[1] = q0 * wx + q2 * wz - q3 * wy;
    d[2] = q0 * wy + q3 * wx - q1 * wz;
    d[3] = q0 * wz + q1 * wy - q2 * wx;
    d[7] = vx + 2.0 * (-(q2 * q2 + q3 * q3) * vx + (q1 * q2 - q0 * q3) * vy +
                       (q1 * q3 + q0 * q2) * vz);
    d[8] = vy + 2.0 * ((q1 * q2 + q0 * q3) * vx - (q1 * q1 + q3 * q3) * vy +
                       (q2 * q3 - q0 * q1) * vz);
}

/* P2, thin disc on its sharp rim. e = k_h/|k_h| points from the contact to the centre,
 * t = e3 x e; Th is diagonal on (e, t, e3) and c = a e. */
INLINE void rhs_disc(const double *restrict y, double *restrict d) {
    const double m = 1.0, a = 0.25;
    const double A = 0.25 * m * a * a, B = A + m * a * a, D = 1.5 * m * a * a;
    const double q0 = y[0], q1 = y[1], q2 = y[2], q3 = y[3], w3 = y[6];
    const double k1 = 2.0 * (q1 * q3 - q0 * q2), k2 = 2.0 * (q2 * q3 + q0 * q1);
    const double k3 = 1.0 - 2.0 * (q1 * q1 + q2 * q2);
    const double r = 1.0 / sqrt(k1 * k1 + k2 * k2); /* 1 / |k_h| */
    const double ex = k1 * r, ey = k2 * r;
    const double we = ex * y[4] + ey * y[5], wt = ex * y[5] - ey * y[4];
    const double V = a * (w3 - k3 * we * r); /* along t [m/s] */
    const double ae = (B - D) / A * wt * w3;
    const double at = (m * a * (G * k3 - V * we) + (D - A) * w3 * we) * (1.0 / B);
    d[4] = ex * ae - ey * at;
    d[5] = ey * ae + ex * at;
    d[6] = (A - B) / D * we * wt;
    kinematics(y, -a * w3 * ey, a * w3 * ex, -a * wt, d);
}

/* P3, rattleback: ellipsoid with the centre h above the centre of mass on e3. */
INLINE void rhs_rattleback(const double *restrict y, double *restrict d) {
    const double m = 1.0, h = 0.01;
    const double aa = 0.2 * 0.2, bb = 0.03 * 0.03, cc = 0.02 * 0.02;
    const double Ixx = 2e-4, Iyy = 1.6e-3, Izz = 1.7e-3, Ixy = -2e-5;
    const double q0 = y[0], q1 = y[1], q2 = y[2], q3 = y[3];
    const double wx = y[4], wy = y[5], wz = y[6];
    const double n1 = 2.0 * (q0 * q2 - q1 * q3), n2 = -2.0 * (q2 * q3 + q0 * q1);
    const double n3 = 2.0 * (q1 * q1 + q2 * q2) - 1.0;
    /* rho = A n / s,  V = (A n' - rho (rho . n')) / s,  n' = n x w,  s^2 = n . A n */
    const double p1 = n2 * wz - n3 * wy, p2 = n3 * wx - n1 * wz, p3 = n1 * wy - n2 * wx;
    const double r = 1.0 / sqrt(aa * n1 * n1 + bb * n2 * n2 + cc * n3 * n3);
    const double x = aa * n1 * r, yy = bb * n2 * r, z = cc * n3 * r;
    const double rp = x * p1 + yy * p2 + z * p3;
    const double V1 = (aa * p1 - x * rp) * r, V2 = (bb * p2 - yy * rp) * r,
                 V3 = (cc * p3 - z * rp) * r;
    const double c1 = -x, c2 = -yy, c3 = -h - z;
    /* f = m (-g k - V x w) */
    const double f1 = m * (G * n1 - (V2 * wz - V3 * wy));
    const double f2 = m * (G * n2 - (V3 * wx - V1 * wz));
    const double f3 = m * (G * n3 - (V1 * wy - V2 * wx));
    const double a = Ixx + m * (c2 * c2 + c3 * c3), b = Ixy - m * c1 * c2,
                 c = -m * c1 * c3, e = Iyy + m * (c1 * c1 + c3 * c3), f = -m * c2 * c3,
                 g = Izz + m * (c1 * c1 + c2 * c2);
    const double L1 = a * wx + b * wy + c * wz, L2 = b * wx + e * wy + f * wz,
                 L3 = c * wx + f * wy + g * wz;
    const double M1 = c2 * f3 - c3 * f2 - (wy * L3 - wz * L2);
    const double M2 = c3 * f1 - c1 * f3 - (wz * L1 - wx * L3);
    const double M3 = c1 * f2 - c2 * f1 - (wx * L2 - wy * L1);
    /* Th^-1 by the adjugate of [[a, b, c], [b, e, f], [c, f, g]] */
    const double j11 = e * g - f * f, j12 = c * f - b * g, j13 = b * f - c * e;
    const double j22 = a * g - c * c, j23 = b * c - a * f, j33 = a * e - b * b;
    const double i = 1.0 / (a * j11 + b * j12 + c * j13);
    d[4] = i * (j11 * M1 + j12 * M2 + j13 * M3);
    d[5] = i * (j12 * M1 + j22 * M2 + j23 * M3);
    d[6] = i * (j13 * M1 + j23 * M2 + j33 * M3);
    kinematics(y, wy * c3 - wz * c2, wz * c1 - wx * c3, wx * c2 - wy * c1, d);
}

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
