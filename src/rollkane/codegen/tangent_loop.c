/* Changes of a motion's states along its steps. Before this text: along_steps.h, and
 * generated VARIED (numbers that change, apart from the
 * state), NUMBERS and ROWS (that prepare leaves for rates), and prepare, rates, advance.
 *
 * A row holds one number for each of LANES changes; where there are more, the motion is
 * gone through again for the next, by another processor as each member of a batch.
 */
#if !ON_DEVICE
enum { SPREAD = LANES };
#endif

enum { SHARED_AT, TANGENTS_AT, Y_AT, DY_AT, WAY_AT };

/* Rows of XLA's buffers, which need not begin where rows may; on a GPU, of whose threads
 * each has one of SPREAD changes, the numbers of that. */
static void load_rows(row *x, const real *from, long count) {
#if ON_DEVICE
    for (long i = 0; i < count; i++) x[i] = from[i * SPREAD];
#else
    memcpy(x, from, count * sizeof *x);
#endif
}

static void store_rows(real *to, const row *x, long count) {
#if ON_DEVICE
    for (long i = 0; i < count; i++) to[i * SPREAD] = x[i];
#else
    memcpy(to, x, count * sizeof *x);
#endif
}

static void show(real *shown, long output, const row *dy) {
    store_rows(shown + output * N * SPREAD, dy, N);
}

static void push(const Way *way, const real *shared, const row *tangents, real *y, row *dy,
                 real *shown) {
    real u[NUMBERS + 1];
    row v[ROWS + 1], unreached[N];
    long output = last_of(way, 0) + 1;
    prepare(shared, tangents, u, v);
    show(shown, 0, dy);
    for (int c = 0; c < N; c++) unreached[c] = splat((real)NAN);
    for (long i = 1; i < way->output_count; i++) show(shown, i, unreached);
    for (long i = 0; i < way->count; i++) {
        const Step step = step_of(way, i);
        const real s = way->sense;
        advance(s * step.begin, s * step.end, s * (step.end - step.begin), y, dy, shared,
                tangents, u, v);
        if (output < way->output_count && shows(way, step, output)) {
            output = last_of(way, output);
            show(shown, output++, dy);
        }
    }
}

/* So many rows of changes has each member. */
static long groups_of(const Call *call) {
    const Buffer *changes = &call->given[DY_AT];
    return changes->dims[changes->leads];
}

/* A member's row of changes; of it those from lane on. */
static void push_row(const Call *call, long b, long g, long lane) {
    const Way way = way_of(call, WAY_AT, b);
    row tangents[VARIED + 1], dy[N];
    real y[N], *last = wanted(call, 1, b) + g * N * SPREAD + lane;
    load_rows(tangents, member(call, TANGENTS_AT, b) + g * VARIED * SPREAD + lane, VARIED);
    load_rows(dy, member(call, DY_AT, b) + g * N * SPREAD + lane, N);
    memcpy(y, member(call, Y_AT, b), sizeof y);
    push(&way, member(call, SHARED_AT, b), tangents, y, dy,
         wanted(call, 0, b) + g * way.output_count * N * SPREAD + lane);
    store_rows(last, dy, N);
}
