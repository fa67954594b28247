/* One motion in the loop over lanes, called from XLA. Before this text: xla_call.h and
 * lane_loop.c with one lane.
 */

enum { SHARED_AT, Y_AT, ATOL_AT, NUMBERS_AT, ENDS_AT, BEGINS_AT, TIMES_AT };

/* Which output each stop is, -1 for none; ends that are infinite are none. */
static long slots_of(Queue *q, const real *times, long ends, int64_t *slots) {
    long stop = 0, output = 0;
    for (; stop < ends && isfinite(q->ends[stop]); stop++) {
        const real time = output < q->outputs ? times[output] : (real)INFINITY;
        const int shown = q->ends[stop] <= time && time <= q->begins[stop];
        slots[stop] = shown ? output++ : -1;
    }
    return stop;
}

static void run_member(const Call *call, long b) {
    const real *numbers = member(call, NUMBERS_AT, b);
    const real *times = member(call, TIMES_AT, b);
    const long ends = size_of(&call->given[ENDS_AT]);
    Queue q = {
        .count = 1,
        .outputs = size_of(&call->given[TIMES_AT]),
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
    int64_t steps, rejected, *slots = malloc((ends + 1) * sizeof *slots);
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
    q.slots = slots;
    q.stops = slots_of(&q, times, ends, slots);
    if (q.stops)
        integrate(&q, &out);
    else { /* no time to go to */
        code = BAD_START, steps = rejected = 0;
        told[0] = q.time;
        memcpy(out.final_y, q.starts, N * sizeof(real));
    }
    free(slots);
    told[0] *= q.sense;
    told[1] = (real)code;
    told[2] = (real)steps;
    told[3] = (real)rejected;
}

XLA_FFI_Error *called_by_xla(XLA_FFI_CallFrame *frame) {
    static const int axes[] = {1, 1, 1, 1, 1, 1, 1};
    Call call;
    if (!received(frame, axes, 2, &call)) return NULL;
    for (long b = 0; b < call.batch; b++) run_member(&call, b);
    return NULL;
}
