/* Numbers, and rows of one number for each lane. Generated before this text: real,
 * C (a function's name for it), REAL_IS_DOUBLE, BYTES (of a row), ONE_LANE.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { LANES = BYTES / sizeof(real) };
#ifndef ON_DEVICE /* the text of a GPU says it before */
#define ON_DEVICE 0
#define LOCAL static _Thread_local /* arrays that are too large for a thread's stack */
#endif
#define INLINE static inline __attribute__((always_inline, unused))
#ifdef _WIN32 /* known to all texts of a program, and to nobody else */
#define OF_THE_PROGRAM __attribute__((noinline))
#else
#define OF_THE_PROGRAM __attribute__((noinline, visibility("hidden")))
#endif

#if REAL_IS_DOUBLE
typedef int64_t whole; /* of as many bits */
#else
typedef int32_t whole;
#endif
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
/* Fused multiply-adds, rounded once, of every compiler (which forms none of its own). They
 * round twice on a processor that has none. In long double there are none. */
#define FUSED ((ON_DEVICE || HAS_FMA) && !(ONE_LANE && BYTES > 8))
#if defined __FMA__ || defined __aarch64__
#define HAS_FMA 1
#else
#define HAS_FMA 0
#endif
#ifndef __has_builtin
#define __has_builtin(name) 0
#endif
#if !FUSED
#define FUSE_ONE(x, y, z) ((x) * (y) + (z))
#else
#define FUSE_ONE(x, y, z) C(fma)(x, y, z)
#endif
#if REAL_IS_DOUBLE
#define OF_REALS(name) name##pd
#else
#define OF_REALS(name) name##ps
#endif
#define JOIN(a, b) a##b
#define JOINED(a, b) JOIN(a, b)
/* by GCC's names, where it has them: it compiles loops over lanes ten times slower */
#if !FUSED || ONE_LANE
#define FUSE_ROW(named, sign, x, y, plus, z) FUSE_ONE(sign x, y, plus z)
#elif __has_builtin(__builtin_elementwise_fma)
#define FUSE_ROW(named, sign, x, y, plus, z) __builtin_elementwise_fma(sign x, y, plus z)
#elif BYTES == 64 && __has_builtin(__builtin_ia32_vfmsubpd512_mask)
#define FUSE_ROW(named, sign, x, y, plus, z)                                           \
    JOINED(OF_REALS(__builtin_ia32_v##named), 512_mask)(x, y, z, (1 << LANES) - 1, 4)
#elif BYTES == 32 && __has_builtin(__builtin_ia32_vfmsubpd256)
#define FUSE_ROW(named, sign, x, y, plus, z)                                           \
    JOINED(OF_REALS(__builtin_ia32_v##named), 256)(x, y, z)
#elif BYTES == 16 && __has_builtin(__builtin_ia32_vfmsubpd)
#define FUSE_ROW(named, sign, x, y, plus, z) OF_REALS(__builtin_ia32_v##named)(x, y, z)
#else
#define FUSE_ROW(named, sign, x, y, plus, z)                                           \
    ({                                                                                 \
        row r;                                                                         \
        for (int l = 0; l < LANES; l++)                                                \
            LANE(r, l) = FUSE_ONE(sign LANE(x, l), LANE(y, l), plus LANE(z, l));       \
        r;                                                                             \
    })
#endif
#define FUSED_AS(name, named, sign, plus)                                              \
    INLINE real name##_one(real x, real y, real z) { return FUSE_ONE(sign x, y, plus z); } \
    INLINE row name##_row(row x, row y, row z) {                                       \
        return FUSE_ROW(named, sign, x, y, plus, z);                                   \
    }
FUSED_AS(fma, fmadd, +, +) FUSED_AS(fms, fmsub, +, -)
FUSED_AS(fnma, fnmadd, -, +) FUSED_AS(fnms, fnmsub, -, -)

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
/* Whole numbers, of 64 bits whatever the real ones have: they wrap, and trap nothing. */
#if ONE_LANE
typedef int64_t whole_row;
#else
typedef int64_t whole_row __attribute__((vector_size(LANES * 8)));
#endif
#define EACH_LANE for (int l = 0; l < LANES; l++)
#define WHOLE_ONE(name, text)                                                          \
    INLINE int64_t name##_one(int64_t a) { return text; }                              \
    INLINE whole_row name##_row(whole_row x) {                                         \
        whole_row r;                                                                   \
        EACH_LANE LANE(r, l) = name##_one(LANE(x, l));                                 \
        return r;                                                                      \
    }
#define WHOLE_TWO(name, text)                                                          \
    INLINE int64_t name##_whole_one(int64_t a, int64_t b) { return text; }             \
    INLINE whole_row name##_whole_row(whole_row x, whole_row y) {                      \
        whole_row r;                                                                   \
        EACH_LANE LANE(r, l) = name##_whole_one(LANE(x, l), LANE(y, l));               \
        return r;                                                                      \
    }
#define WHOLE_COMPARED(name, sign)                                                     \
    INLINE int name##_whole_one(int64_t a, int64_t b) { return a sign b; }             \
    INLINE mask name##_whole_row(whole_row x, whole_row y) {                           \
        mask r;                                                                        \
        EACH_LANE LANE(r, l) = LANE(x, l) sign LANE(y, l) ? YES : 0;                   \
        return r;                                                                      \
    }
#define WRAPPED(sign) (int64_t)((uint64_t)a sign (uint64_t)b)
WHOLE_TWO(add, WRAPPED(+)) WHOLE_TWO(sub, WRAPPED(-)) WHOLE_TWO(mul, WRAPPED(*))
WHOLE_TWO(div, b == 0 ? -1 : b == -1 ? (int64_t)(0 - (uint64_t)a) : a / b)
WHOLE_TWO(rem, b == 0 ? a : b == -1 ? 0 : a % b)
WHOLE_TWO(max, a > b ? a : b) WHOLE_TWO(min, a < b ? a : b)
WHOLE_TWO(and, a & b) WHOLE_TWO(or, a | b) WHOLE_TWO(xor, a ^ b)
WHOLE_TWO(left, b < 0 || b > 63 ? 0 : (int64_t)((uint64_t)a << b))
WHOLE_TWO(right, a >> (b < 0 || b > 63 ? 63 : b))
WHOLE_TWO(logical, b < 0 || b > 63 ? 0 : (int64_t)((uint64_t)a >> b))
WHOLE_ONE(neg_whole, (int64_t)(0 - (uint64_t)a)) WHOLE_ONE(not_whole, ~a)
WHOLE_ONE(abs_whole, a < 0 ? (int64_t)(0 - (uint64_t)a) : a)
WHOLE_ONE(sign_whole, (a > 0) - (a < 0))
WHOLE_ONE(square_whole, (int64_t)((uint64_t)a * (uint64_t)a))
WHOLE_ONE(int8_of, (int8_t)a) WHOLE_ONE(int16_of, (int16_t)a) WHOLE_ONE(int32_of, (int32_t)a)
WHOLE_ONE(uint8_of, (uint8_t)a) WHOLE_ONE(uint16_of, (uint16_t)a)
WHOLE_ONE(uint32_of, (uint32_t)a)
WHOLE_COMPARED(lt, <) WHOLE_COMPARED(le, <=) WHOLE_COMPARED(gt, >) WHOLE_COMPARED(ge, >=)
WHOLE_COMPARED(eq, ==) WHOLE_COMPARED(ne, !=)
INLINE int64_t clamp_whole_one(int64_t low, int64_t a, int64_t high) {
    return min_whole_one(max_whole_one(a, low), high);
}
INLINE whole_row clamp_whole_row(whole_row low, whole_row x, whole_row high) {
    return min_whole_row(max_whole_row(x, low), high);
}
INLINE int64_t choose_whole_one(int m, int64_t a, int64_t b) { return m ? a : b; }
INLINE whole_row choose_whole_row(mask m, whole_row x, whole_row y) {
    whole_row r;
    EACH_LANE LANE(r, l) = LANE(m, l) ? LANE(x, l) : LANE(y, l);
    return r;
}
INLINE whole_row splat_whole(int64_t a) {
    whole_row r;
    EACH_LANE LANE(r, l) = a;
    return r;
}
/* like XLA's: of what is not a number zero, of what is too large the largest */
INLINE int64_t whole_of_one(real x, int bits, int has_sign) {
    const real above = C(ldexp)((real)1, bits - has_sign), least = has_sign ? -above : 0;
    const int64_t most = INT64_MAX >> (64 - bits - !has_sign);
    if (x != x) return 0;
    return x >= above ? most : x <= least ? (has_sign ? -most - 1 : 0) : (int64_t)x;
}
INLINE whole_row whole_of_row(row x, int bits, int has_sign) {
    whole_row r;
    EACH_LANE LANE(r, l) = whole_of_one(LANE(x, l), bits, has_sign);
    return r;
}
INLINE row real_of_whole_row(whole_row x) {
    row r;
    EACH_LANE LANE(r, l) = (real)LANE(x, l);
    return r;
}
INLINE whole_row whole_of_mask(mask m) {
    whole_row r;
    EACH_LANE LANE(r, l) = LANE(m, l) != 0;
    return r;
}
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
