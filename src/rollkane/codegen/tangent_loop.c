/* Changes of a motion's states along its steps, called from XLA. Before this text:
 * along_steps.h, threads.h, and generated VARIED (numbers that change, apart from the
 * state), NUMBERS and ROWS (that prepare leaves for rates), and prepare, rates, advance.
 *
 * A row holds one number for each of LANES changes; where there are more, the motion is
 * gone through again for the next, by another processor as each member of a batch.
 */

enum { SHARED_AT, TANGENTS_AT, Y_AT, DY_AT, WAY_AT };

static void show(real *shown, long output, const row *dy) {
    memcpy(shown + output * N * LANES, dy, N * sizeof(row));
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

static void push_group(void *job, long part) {
    const Call *call = job;
    const long b = part / groups_of(call), g = part % groups_of(call);
    const Way way = way_of(call, WAY_AT, b);
    /* XLA's buffers need not begin where rows may */
    row tangents[VARIED + 1], dy[N];
    real y[N];
    memcpy(tangents, member(call, TANGENTS_AT, b) + g * VARIED * LANES,
           VARIED * sizeof(row));
    memcpy(dy, member(call, DY_AT, b) + g * N * LANES, sizeof dy);
    memcpy(y, member(call, Y_AT, b), sizeof y);
    push(&way, member(call, SHARED_AT, b), tangents, y, dy,
         wanted(call, 0, b) + g * way.output_count * N * LANES);
    memcpy(wanted(call, 1, b) + g * N * LANES, dy, sizeof dy);
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 3, 1, 3, 1, 0, 0, 1, 2};
    Call call;
    if (!received(frame, axes, 4, &call)) return NULL;
    in_parallel(push_group, &call, call.batch * groups_of(&call));
    return NULL;
}
