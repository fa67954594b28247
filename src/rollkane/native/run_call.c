/* One motion in the loop over lanes, called from XLA; of a batch, one after the other on
 * every processor. Before this text: xla_call.h, lane_loop.c with one lane, settle_stops.h
 * and threads.h.
 */

enum { SHARED_AT, Y_AT, ATOL_AT, NUMBERS_AT, ENDS_AT, BEGINS_AT, TIMES_AT };

static void run_member(void *job, long b) {
    const Call *call = job;
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
    in_parallel(run_member, &call, call.batch);
    return NULL;
}
