/* One motion in the loop over lanes, called from XLA. Before this text: xla_call.h and
 * lane_loop.c with one lane.
 */

enum { SHARED_AT, Y_AT, ATOL_AT, NUMBERS_AT, ENDS_AT, BEGINS_AT, TIMES_AT };

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

static void run_member(const Call *call, long b) {
    const real *numbers = member(call, NUMBERS_AT, b);
    const real *times = member(call, TIMES_AT, b);
    const long given = size_of(&call->given[ENDS_AT]);
    Queue q = {
        .count = 1,
        .outputs = size_of(&call->given[TIMES_AT]),
        .stops = given,
        .starts = member(call, Y_AT, b),
        .shared = member(call, SHARED_AT, b),
        .atol = member(call, ATOL_AT, b),
        .ends = member(call, ENDS_AT, b),
        .begins = member(call, BEGINS_AT, b),
        .time = numbers[0],
        .sense = numbers[1],
        .rtol = numbers[2],
        .dtmin = numbers[3],
        .first_steps = numbers + 4,
        .max_steps = (int64_t)numbers[5],
    };
    int64_t steps, rejected, *slots = malloc((given + 1) * sizeof *slots);
    real *ends = malloc(2 * (given + 1) * sizeof *ends);
    int32_t code;
    real *told = wanted(call, 2, b);
    const Results out = {
        .y = wanted(call, 0, b),
        .code = &code,
        .final_time = told,
        .final_y = wanted(call, 1, b),
        .steps = &steps,
        .rejected = &rejected,
#if RECORD
        .record = wanted(call, 3, b),
        .kept = wanted(call, 4, b),
#endif
    };
    for (long i = 0; i < q.outputs * N; i++) out.y[i] = (real)NAN;
    settle_stops(&q, times, ends, ends + given + 1, slots);
    if (q.stops)
        integrate(&q, &out);
    else { /* no time to go to */
        code = BAD_START, steps = rejected = 0;
        told[0] = q.time;
        memcpy(out.final_y, q.starts, N * sizeof(real));
#if RECORD
        out.record[0] = q.sense * q.time;
#endif
    }
    free(slots), free(ends);
    told[0] *= q.sense;
    told[1] = (real)code;
    told[2] = (real)steps;
    told[3] = (real)rejected;
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 1, 1, 1, 1, 1, 1};
    Call call;
    if (!received(frame, axes, 2, &call)) return NULL;
    for (long b = 0; b < call.batch; b++) run_member(&call, b);
    return NULL;
}
