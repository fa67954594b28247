/* Numbers, and rows of one number for each lane. Generated before this text: real,
 * C (a function's name for it), REAL_IS_DOUBLE, BYTES (of a row), ONE_LANE.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { LANES = BYTES / sizeof(real) };
#define INLINE static inline __attribute__((always_inline, unused))

#if ONE_LANE /* a vector of one number goes through registers that cannot compute */
typedef real row;
typedef int mask;
#define LANE(x, l) (x)
#define YES 1
INLINE row splat(real x) { return x; }
INLINE mask mask_of(int yes) { return yes != 0; }
INLINE mask not_row(mask m) { return !m; }
INLINE row choose_row(mask m, row a, row b) { return m ? a : b; }
INLINE int any(mask m) { return m; }
#else
#if REAL_IS_DOUBLE
typedef int64_t whole;
#else
typedef int32_t whole;
#endif
typedef real row __attribute__((vector_size(BYTES)));
typedef whole mask __attribute__((vector_size(BYTES)));
#define LANE(x, l) ((x)[l])
#define YES -1
INLINE row splat(real x) { return (row){0} + x; }
INLINE mask mask_of(int yes) { return (mask){0} - (whole)(yes != 0); }
INLINE mask not_row(mask m) { return ~m; }
INLINE row choose_row(mask m, row a, row b) {
    return (row)((m & (mask)a) | (~m & (mask)b));
}
INLINE int any(mask m) {
    whole total = 0;
    for (int l = 0; l < LANES; l++) total |= m[l];
    return total != 0;
}
#endif
INLINE int not_one(int m) { return !m; }
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
#define ONE(name, f)                                                                   \
    INLINE real name##_one(real x) { return C(f)(x); }                                 \
    INLINE row name##_row(row x) {                                                     \
        row r;                                                                         \
        for (int l = 0; l < LANES; l++) LANE(r, l) = C(f)(LANE(x, l));                 \
        return r;                                                                      \
    }
#define TWO(name, f)                                                                   \
    INLINE real name##_one(real x, real y) { return C(f)(x, y); }                      \
    INLINE row name##_row(row x, row y) {                                              \
        row r;                                                                         \
        for (int l = 0; l < LANES; l++) LANE(r, l) = C(f)(LANE(x, l), LANE(y, l));     \
        return r;                                                                      \
    }
ONE(acos, acos) ONE(acosh, acosh) ONE(asin, asin) ONE(asinh, asinh) ONE(atan, atan)
ONE(atanh, atanh) ONE(cbrt, cbrt) ONE(ceil, ceil) ONE(cos, cos) ONE(cosh, cosh)
ONE(exp, exp) ONE(exp2, exp2) ONE(expm1, expm1) ONE(floor, floor) ONE(log, log)
ONE(log1p, log1p) ONE(sin, sin) ONE(sinh, sinh) ONE(sqrt, sqrt) ONE(tan, tan)
ONE(tanh, tanh) ONE(trunc, trunc) ONE(rint, rint) ONE(round, round) ONE(erf, erf)
ONE(erfc, erfc) ONE(lgamma, lgamma) TWO(atan2, atan2) TWO(pow, pow) TWO(rem, fmod)
/* Of a table's every n-th number the one of an index, the nearest if it has none;
 * the first if that is not a number. */
INLINE real lookup_one(const real *table, long stride, long count, real index) {
    const real last = count - 1;
    const long i = index > 0 ? (index < last ? (long)index : count - 1) : 0;
    return table[i * stride];
}
INLINE row lookup_row(const real *table, long stride, long count, row index) {
    row r;
    for (int l = 0; l < LANES; l++) {
        LANE(r, l) = lookup_one(table, stride, count, LANE(index, l));
    }
    return r;
}
