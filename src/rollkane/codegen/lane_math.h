/* Numbers that loops over lanes need. Before this text: rows.h, and ORDER. */
#define EPSILON (REAL_IS_DOUBLE ? (real)0x1p-52 : sizeof(real) == 4 ? (real)0x1p-23 : (real)0x1p-63)

/* x^(-1/ORDER) for 1e-12 < x < 1e12, from what the bits of a floating point number are: its
 * logarithm to base 2 within 0.043 of a line. So the guess r is within 0.03 (1 + 1/ORDER),
 * 5 % at most, and each turn adds the first terms of r ((1 - e)^(-1/ORDER) - 1), where
 * e = 1 - x r^ORDER: a relative error d becomes (ORDER + 1)(2 ORDER + 1)/6 d^3, below 1e-19
 * after three for the orders 2 to 8. Of a long double, whose bits are others: as it is. */
#if ONE_LANE && BYTES > 8
INLINE row root(row x) { return C(pow)(x, (real)-1 / ORDER); }
#else
#if ONE_LANE
INLINE row bits_of(row x) {
    whole bits;
    memcpy(&bits, &x, sizeof bits);
    return (row)bits;
}
INLINE row of_bits(row x) {
    const whole bits = (whole)x;
    memcpy(&x, &bits, sizeof bits);
    return x;
}
#else
INLINE row bits_of(row x) { return __builtin_convertvector((mask)x, row); }
INLINE row of_bits(row x) { return (row)__builtin_convertvector(x, mask); }
#endif
INLINE row root(row x) {
    const real scale = REAL_IS_DOUBLE ? (real)0x1p52 : (real)0x1p23;
    const real one = ((REAL_IS_DOUBLE ? 1023 : 127) - (real)0.043) * scale;
    const real share = (real)1 / ORDER, second = (real)(ORDER + 1) / (2 * ORDER * ORDER);
    row r = of_bits(splat(one * (1 + share)) - bits_of(x) * share);
    for (int i = 0; i < 3; i++) {
        row left = x, power = r;
        for (int n = ORDER; n > 0; n >>= 1, power *= power)
            if (n % 2) left *= power;
        left = (real)1 - left;
        r = fma_row(r, left * fma_row(left, splat(second), splat(share)), r);
    }
    return r;
}
#endif
