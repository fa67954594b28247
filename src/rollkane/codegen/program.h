/* What a whole program is written with. Before this text: rows.h, MOST_GIVEN and
 * MOST_RESULTS.
 */

typedef struct {
    const real *given[MOST_GIVEN];
    real *left[MOST_RESULTS];
    real *workspace; /* of all arrays in memory */
} Frame;

/* Whether runs are to end where they are (program_call.c). */
OF_THE_PROGRAM int to_end_now(void);

/* The largest numbers of a row, in order, and where they are; what is not one first. */
INLINE void largest(long n, const real *x, long stride, long k, real *top, real *place) {
    long count = 0;
    for (long i = 0; i < n; i++) {
        const real one = x[i * stride];
        long at = count;
        while (at > 0 && (one > top[at - 1] || (one != one && top[at - 1] == top[at - 1])))
            at--;
        if (at == k) continue;
        if (count < k) count++;
        for (long j = count - 1; j > at; j--) top[j] = top[j - 1], place[j] = place[j - 1];
        top[at] = one, place[at] = (real)i;
    }
}

/* Put numbers in order, what is not one last, and others, if any, as they go; with room for
 * as many of both. */
INLINE void sort(long n, real *x, real *room, real *others, real *room_of_others) {
    for (long half = 1; half < n; half *= 2) {
        for (long k = 0; k < n;) {
            const long from = k, middle = from + half < n ? from + half : n;
            const long end = middle + half < n ? middle + half : n;
            for (long i = from, j = middle; k < end; k++) {
                const int second = j < end && (x[j] < x[i] || (x[i] != x[i] && x[j] == x[j]));
                const long taken = i < middle && !second ? i++ : j++;
                room[k] = x[taken];
                if (others) room_of_others[k] = others[taken];
            }
        }
        memcpy(x, room, n * sizeof *x);
        if (others) memcpy(others, room_of_others, n * sizeof *others);
    }
}
