/* A batch of runs in modes, called from XLA: the program of one member takes the steps in
 * which there is something to decide, lanes of each mode the others (plain_steps.c).
 * Before this text: xla_call.h, program.h, the program, threads.h and lane_math.h, and the
 * names that member_lanes.py generates; behind it plain_steps.c and member_lanes_call.c.
 *
 * The program goes from what a run carries to what it carries, behind which it tells what
 * lanes have to know. Small arrays of both lie one behind the other, what is carried last
 * in what is given, first in what is left; the larger ones lie where they are left.
 */

OF_THE_PROGRAM int to_end_now(void) { return told_to_end(); }

typedef struct {
    const Call *call;
    long first, count;            /* of its members */
    const real *shared;
    real *small, *workspace;      /* small arrays that each member is given */
    long *queue[MODES];           /* members that wait for lanes of a mode */
    long waiting[MODES];
} Block;

INLINE real *carried(const Block *b, long i) {
    return b->small + (i + 1) * GIVEN_SMALL - CARRIED;
}
INLINE const real *told_of(const Block *b, long i) {
    return wanted(b->call, 0, b->first + i) + CARRIED;
}

/* Where one of two values may dip below zero inside of a step, by what was seen of it
 * (event_bounds.py: between). */
static mask may_dip(row seen[][SEEN]) {
    mask dips = mask_of(0);
    for (int c = 0; c < 2; c++) {
        const row known[] = {seen[0][c], seen[STAGES][c], seen[STAGES + 1][c],
                             seen[STAGES - 1][c]};
        row spread = splat(0), largest = splat(0);
        for (int i = 0; i < LOOKS; i++) {
            row off = seen[i][c];
            for (int j = 0; j < 4; j++) off = fnma_row(known[j], splat(through_seen[i][j]), off);
            largest = max_row(largest, abs_row(seen[i][c]));
            if (bulge_seen[i] > (real)0.25)
                spread = max_row(spread, abs_row(off) / bulge_seen[i]);
        }
        spread *= SAFETY;
        const row slack = largest * (ROUNDING * EPSILON);
        for (int i = 0; i < PLACES; i++) {
            row bound = slack - spread * bulge_places[i];
            for (int j = 0; j < 4; j++) bound = fma_row(known[j], splat(through_places[i][j]), bound);
            dips |= not_row(bound > 0);
        }
    }
    return dips;
}

/* Let the program decide what a member does, until its steps are plain; gives the mode in
 * whose lanes it goes on, -1 for none: it has ended. */
static int decide(const Block *b, long i, int begins) {
    const long at = b->first + i;
    Frame frame;
    for (int g = 1; g < PROGRAM_GIVEN; g++) frame.given[g] = member(b->call, g, at);
    for (int r = 0; r < PROGRAM_LEFT; r++) frame.left[r] = wanted(b->call, r, at);
    for (int r = 1; r < PROGRAM_LEFT && !begins; r++)
        frame.given[PROGRAM_GIVEN - PROGRAM_LEFT + r] = frame.left[r];
    frame.given[0] = b->small + i * GIVEN_SMALL;
    frame.workspace = b->workspace;
    run(&frame);
    memcpy(carried(b, i), frame.left[0], CARRIED * sizeof(real));
    return told_to_end() ? -1 : (int)frame.left[0][CARRIED + TOLD_LANE] - 1;
}
