/* Numbers that loops over lanes need. Before this text: rows.h, and ORDER. */
#define EPSILON (REAL_IS_DOUBLE ? (real)0x1p-52 : sizeof(real) == 4 ? (real)0x1p-23 : (real)0x1p-63)

/* x^(-1/ORDER) for 1e-12 < x < 1e12: Newton's method, from what the bits of a floating
 * point number are: its logarithm to base 2 within 0.087. So the guess is within
 * 2^(0.087 (1 + 1/ORDER)), 9 % at most, and an error e becomes (ORDER + 1) / 2 e^2: below
 * 1e-16 after six times for the orders 3 to 8. */
INLINE row root(row x) {
#if ONE_LANE
    return C(pow)(x, (real)-1 / ORDER); /* a shorter chain */
#else
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
#endif
}
