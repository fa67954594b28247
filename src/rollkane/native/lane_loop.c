/* Many motions in one loop over lanes. Generated before this text: real, N (numbers of a
 * state), OWN (numbers of a model that differ), STAGES, ORDER, UNIFORM; behind the first
 * part: prepare, rates, attempt.
 *
 * Every lane has a time and a step of its own. One that reaches a stop writes its output
 * and goes on; one that ends takes the next motion of the queue. The steps are those of
 * diffrax's explicit Runge-Kutta methods under its default controller.
 */
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { LANES = BYTES / sizeof(real) };
typedef real row __attribute__((vector_size(BYTES)));
#if REAL_IS_DOUBLE
typedef int64_t whole;
#else
typedef int32_t whole;
#endif
typedef whole mask __attribute__((vector_size(BYTES)));

#define INLINE static inline __attribute__((always_inline, unused))

INLINE row splat(real x) { return (row){0} + x; }
INLINE mask mask_of(int yes) { return (mask){0} - (whole)(yes != 0); }
INLINE row choose_row(mask m, row a, row b) {
    return (row)((m & (mask)a) | (~m & (mask)b));
}
INLINE real choose_one(int m, real a, real b) { return m ? a : b; }
/* like XLA's: what is not a number stays so */
INLINE row max_row(row a, row b) { return choose_row((a > b) | (a != a), a, b); }
INLINE row min_row(row a, row b) { return choose_row((a < b) | (a != a), a, b); }
INLINE real max_one(real a, real b) { return a > b || a != a ? a : b; }
INLINE real min_one(real a, real b) { return a < b || a != a ? a : b; }
INLINE row abs_row(row a) { return choose_row(a < 0, -a, a); }
INLINE real abs_one(real a) { return a < 0 ? -a : a; }
INLINE row sign_row(row a) {
    row one = splat(1);
    return choose_row(a > 0, one, choose_row(a < 0, -one, a));
}
INLINE real sign_one(real a) { return a > 0 ? 1 : a < 0 ? -1 : a; }
INLINE int any(mask m) {
    whole total = 0;
    for (int l = 0; l < LANES; l++) total |= m[l];
    return total != 0;
}

#if REAL_IS_DOUBLE
#define C(name) name
#else
#define C(name) name##f
#endif
#define ONE(name, f)                                                                   \
    INLINE real name##_one(real x) { return C(f)(x); }                                 \
    INLINE row name##_row(row x) {                                                     \
        row r;                                                                         \
        for (int l = 0; l < LANES; l++) r[l] = C(f)(x[l]);                             \
        return r;                                                                      \
    }
#define TWO(name, f)                                                                   \
    INLINE real name##_one(real x, real y) { return C(f)(x, y); }                      \
    INLINE row name##_row(row x, row y) {                                              \
        row r;                                                                         \
        for (int l = 0; l < LANES; l++) r[l] = C(f)(x[l], y[l]);                       \
        return r;                                                                      \
    }
ONE(acos, acos) ONE(acosh, acosh) ONE(asin, asin) ONE(asinh, asinh) ONE(atan, atan)
ONE(atanh, atanh) ONE(cbrt, cbrt) ONE(ceil, ceil) ONE(cos, cos) ONE(cosh, cosh)
ONE(exp, exp) ONE(exp2, exp2) ONE(expm1, expm1) ONE(floor, floor) ONE(log, log)
ONE(log1p, log1p) ONE(sin, sin) ONE(sinh, sinh) ONE(sqrt, sqrt) ONE(tan, tan)
ONE(tanh, tanh) TWO(atan2, atan2) TWO(pow, pow) TWO(rem, fmod)

/*GENERATED*/

enum { COMPLETED = 0, MAX_STEPS_REACHED, STEP_TOO_SMALL, BAD_START }; /* Code */

typedef struct {
    long count, outputs, stops;
    const real *starts;      /* [count][N] */
    const real *own;         /* [count][OWN] */
    const real *shared;
    const real *atol;        /* [count][N] */
    const real *first_steps; /* [count] */
    const real *ends, *begins;
    const int64_t *slots;    /* [stops] */
    real time, rtol, dtmin;
    int64_t max_steps;
} Queue;

typedef struct {
    real *y;                 /* [count][outputs][N] */
    int32_t *code;           /* [count] */
    real *final_time, *final_y;
    int64_t *steps, *rejected;
} Results;

typedef struct {
    row t, t_end, wanted, goal, y[N], k[N], atol[N], own[OWN ? OWN : 1];
    mask running, failed;
    int64_t steps[LANES], rejected[LANES];
    long motion[LANES], stop[LANES];
} Lanes;

/* x^(-1/ORDER) for 1e-12 < x < 1e12: Newton's method, from what the bits of a floating
 * point number are: its logarithm to base 2 within 0.087. So the guess is within
 * 2^(0.087 (1 + 1/ORDER)), 9 % at most, and an error e becomes (ORDER + 1) / 2 e^2: below
 * 1e-16 after six times for the orders 3 to 8. */
INLINE row root(row x) {
    if (LANES == 1) return splat(C(pow)(x[0], (real)-1 / ORDER)); /* shorter a chain */
    const real one = REAL_IS_DOUBLE ? (real)4607182418800017408.0 : (real)1065353216.0;
    const row bits = __builtin_convertvector((mask)x, row);
    const row guess = one * ((real)1 + (real)1 / ORDER) - bits * ((real)1 / ORDER);
    row r = (row)__builtin_convertvector(guess, mask);
    for (int i = 0; i < 6; i++) {
        row p = x;
        for (int j = 0; j < ORDER; j++) p *= r;
        r *= (real)1 + ((real)1 - p) / (real)ORDER;
    }
    return r;
}

/* End of a step: the goal, or half the way to it where one step would fall short. On the
 * way to an only goal, like diffrax, the goal where the step would lead past it. */
INLINE row towards(int only, row goal, row t, row dt) {
    const row left = goal - t;
    if (only) return min_row(t + dt, goal);
    const row half = choose_row(dt > left * (real)0.5, left * (real)0.5, dt);
    return choose_row(dt >= left * (real)0.999, goal, t + half);
}

/* Write what a lane has reached; 1 where its rates have to be computed afresh. */
static int visit(const Queue *q, const Results *out, Lanes *a, int l, long *ahead) {
    const long i = a->motion[l];
    int fresh = 0, ended = i < 0 || a->failed[l];
    if (i >= 0 && !ended) {
        const long stop = a->stop[l], slot = q->slots[stop];
        if (slot >= 0)
            for (int c = 0; c < N; c++) out->y[(i * q->outputs + slot) * N + c] = a->y[c][l];
        ended = stop + 1 >= q->stops;
        if (!ended) {
            fresh = q->begins[stop] != a->t[l];
            a->t[l] = q->begins[stop];
            a->stop[l] = stop + 1;
        }
    }
    if (ended && i >= 0) {
        const int64_t tried = a->steps[l] + a->rejected[l];
        out->code[i] = !a->failed[l]              ? COMPLETED
                       : tried >= q->max_steps    ? MAX_STEPS_REACHED
                       : a->steps[l] == 0         ? BAD_START
                                                  : STEP_TOO_SMALL;
        out->final_time[i] = a->t[l];
        for (int c = 0; c < N; c++) out->final_y[i * N + c] = a->y[c][l];
        out->steps[i] = a->steps[l], out->rejected[i] = a->rejected[l];
    }
    if (ended) {
        a->failed[l] = 0, a->steps[l] = a->rejected[l] = 0, a->stop[l] = 0;
        a->motion[l] = *ahead < q->count ? (*ahead)++ : -1;
        const long next = a->motion[l];
        if (next < 0) return 0;
        a->t[l] = q->time, a->wanted[l] = q->first_steps[next];
        for (int c = 0; c < N; c++) {
            a->y[c][l] = q->starts[next * N + c];
            a->atol[c][l] = q->atol[next * N + c];
        }
        for (int c = 0; c < OWN; c++) a->own[c][l] = q->own[next * OWN + c];
        fresh = 1;
    }
    a->running[l] = -1;
    a->goal[l] = q->ends[a->stop[l]];
    return fresh;
}

/* Integrate a queue of motions to its end; returns the steps of the whole row. */
int64_t integrate(const Queue *q, const Results *out) {
    Lanes a;
    real u[UNIFORM ? UNIFORM : 1];
    row k[STAGES][N], y[N], error[N], first[N];
    long ahead = 0;
    int64_t turns = 0;
    memset(&a, 0, sizeof a);
    for (int l = 0; l < LANES; l++) a.motion[l] = -1;
    prepare(q->shared, u);
    for (;;) {
        mask fresh = (mask){0}, moved = (mask){0};
        for (int l = 0; l < LANES; l++) {
            if (a.running[l] || (a.motion[l] < 0 && ahead >= q->count)) continue;
            moved[l] = -1;
            fresh[l] = visit(q, out, &a, l, &ahead) ? -1 : 0;
        }
        if (!any(a.running)) return turns;
        a.t_end = choose_row(moved, towards(q->stops == 1, a.goal, a.t, a.wanted), a.t_end);
        if (any(fresh)) {
            rates(a.t, a.y, q->shared, a.own, u, first);
            for (int c = 0; c < N; c++) a.k[c] = choose_row(fresh, first[c], a.k[c]);
        }
        mask paused;
        do {
            const row h = a.t_end - a.t;
            memcpy(k[0], a.k, sizeof a.k);
            attempt(a.t, a.t_end, h, a.y, q->shared, a.own, u, k, y, error);
            row size = splat(0);
            for (int c = 0; c < N; c++) {
                const row most = max_row(abs_row(a.y[c]), abs_row(y[c]));
                const row e = error[c] / (a.atol[c] + most * q->rtol);
                size += e * e;
            }
            size = sqrt_row(size / (real)N);
            size = choose_row(size < (real)1e12, size, splat((real)1e12)); /* NaN too */
            const mask kept = size < 1;
            row factor = root(max_row(size, splat((real)1e-12))) * (real)0.9;
            const row least = choose_row(kept, splat(1), splat((real)0.2));
            const row most = choose_row(kept, splat(10), splat((real)0.9));
            factor = min_row(max_row(factor, least), most);
            row dt = h * factor;
            const mask small = dt < q->dtmin;
            const mask shortened = kept & (h < a.wanted * (real)0.999);
            dt = choose_row(shortened, max_row(dt, a.wanted), dt);
            const mask go = kept & a.running;
            mask landed = go & (a.t_end >= a.goal);
            a.t = choose_row(go, a.t_end, a.t);
            for (int c = 0; c < N; c++) {
                a.y[c] = choose_row(go, y[c], a.y[c]);
                a.k[c] = choose_row(go, k[STAGES - 1][c], a.k[c]);
            }
            mask out_of_steps = (mask){0};
            for (int l = 0; l < LANES; l++) {
                a.steps[l] -= go[l], a.rejected[l] -= a.running[l] & ~kept[l];
                out_of_steps[l] = -(a.steps[l] + a.rejected[l] >= q->max_steps);
            }
            a.wanted = choose_row(a.running, dt, a.wanted);
            a.t_end = choose_row(a.running, towards(q->stops == 1, a.goal, a.t, dt), a.t_end);
            a.failed |= a.running & (small | (out_of_steps & ~landed));
            paused = a.running & (landed | a.failed);
            a.running &= ~paused;
            turns++;
        } while (!any(paused));
    }
}
