/* The queue of motions that a call from XLA asks for, and where its results go. Before this
 * text: buffers.h and lane_loop.c.
 */

enum { SHARED_AT, OWN_AT, Y_AT, ATOL_AT, FIRST_AT, LONGEST_AT, NUMBERS_AT, ENDS_AT,
       BEGINS_AT, TIMES_AT, ORDER_AT };

/* That of a member of a batch: so many motions, whose stops are yet to be settled. */
static Queue queue_of(const Call *call, long b, long count) {
    const real *numbers = member(call, NUMBERS_AT, b);
    const Queue q = {
        .count = count,
        .outputs = size_of(&call->given[TIMES_AT]),
        .stops = size_of(&call->given[ENDS_AT]),
        .starts = member(call, Y_AT, b),
        .own = member(call, OWN_AT, b),
        .shared = member(call, SHARED_AT, b),
        .atol = member(call, ATOL_AT, b),
        .first_steps = member(call, FIRST_AT, b),
        .ends = member(call, ENDS_AT, b),
        .begins = member(call, BEGINS_AT, b),
        .slots = NULL,
        .time = numbers[0],
        .rtol = numbers[2],
        .dtmin = numbers[3],
        .sense = numbers[1],
        .max_steps = (int64_t)numbers[4],
        .longest = member(call, LONGEST_AT, b),
    };
    return q;
}

/* Of a member of a batch. */
static Results results_of(const Call *call, long b) {
    const Results out = {
        .y = wanted(call, 0, b),
        .final_y = wanted(call, 1, b),
        .told = wanted(call, 2, b),
#if EVENTS
        .moments = wanted(call, 3, b),
#endif
#if RECORD
        .record = wanted(call, 3 + (EVENTS > 0), b),
        .kept = wanted(call, 4 + (EVENTS > 0), b),
#endif
    };
    return out;
}

/* Motions that have no time to go to end where they begin. */
static void stand_still(const Queue *q, const Results *out) {
    for (long i = 0; i < q->count; i++) {
        real *told = out->told + i * TOLD;
        clear(q, out, i);
        for (int c = 0; c < TOLD; c++) told[c] = 0;
        told[0] = q->sense * q->time, told[1] = BAD_START;
#if EVENTS
        told[4 + EVENTS] = -1;
#endif
#if RECORD
        out->record[i * (q->max_steps + 1)] = q->sense * q->time;
#endif
        for (int c = 0; c < N; c++) out->final_y[i * N + c] = q->starts[i * N + c];
    }
}

/* Leave of a queue's stops those behind its first time, each once; those that are infinite
 * are none. Their slots are the outputs that they are, of several the last; -1 for none. */
static void settle_stops(Queue *q, const real *times, real *ends, real *begins,
                         int64_t *slots) {
    const long given = q->stops;
    real last = q->time;
    long output = 0;
    q->stops = 0;
    while (output < q->outputs && times[output] <= last) output++;
    for (long i = 0; i < given && isfinite(q->ends[i]); i++) {
        const real end = q->ends[i], begin = q->begins[i];
        if (!(end > last)) continue;
        int64_t slot = -1;
        while (output < q->outputs && end <= times[output] && times[output] <= begin)
            slot = output++;
        ends[q->stops] = last = end;
        begins[q->stops] = begin;
        slots[q->stops++] = slot;
    }
    q->ends = ends, q->begins = begins, q->slots = slots;
}
