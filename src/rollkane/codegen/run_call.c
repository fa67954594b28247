/* One motion in the loop over lanes, called from XLA; of a batch, one after the other on
 * every processor. Before this text: xla_call.h, lane_loop.c with one lane, queue.h and
 * threads.h.
 */

static void run_member(void *job, long b) {
    const Call *call = job;
    Queue q = queue_of(call, b, 1);
    const long given = q.stops;
    int64_t steps, rejected, *slots = malloc((given + 1) * sizeof *slots);
    real *ends = malloc(2 * (given + 1) * sizeof *ends);
    int32_t code;
#if EVENTS
    int64_t numbers[EVENTS + 1] = {0};
    real *moments = wanted(call, 3, b);
    for (long i = 0; i < EVENT_CAPACITY * (1 + N); i++) moments[i] = (real)NAN;
    numbers[EVENTS] = -1;
#endif
    real *told = wanted(call, 2, b);
    const Results out = {
        .y = wanted(call, 0, b),
        .code = &code,
        .final_time = told,
        .final_y = wanted(call, 1, b),
        .steps = &steps,
        .rejected = &rejected,
#if RECORD
        .record = wanted(call, 3 + (EVENTS > 0), b),
        .kept = wanted(call, 4 + (EVENTS > 0), b),
#endif
#if EVENTS
        .moments = moments,
        .numbers = numbers,
#endif
    };
    for (long i = 0; i < q.outputs * N; i++) out.y[i] = (real)NAN;
    settle_stops(&q, member(call, TIMES_AT, b), ends, ends + given + 1, slots);
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
#if EVENTS
    for (int e = 0; e <= EVENTS; e++) told[4 + e] = (real)numbers[e];
#endif
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 1, 1, 1, 1, 1, 1, 1, 1};
    Call call;
    if (!received(frame, axes, 2, &call)) return NULL;
    in_parallel(run_member, &call, call.batch);
    return NULL;
}
