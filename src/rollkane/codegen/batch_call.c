/* A batch of motions in the loop over lanes, called from XLA: blocks of it on every
 * processor. Before this text: xla_call.h, lane_loop.c, queue.h and threads.h.
 */

/* final time, code, steps, rejected steps; of events, how often, and which ended the run */
enum { TOLD = 4 + (EVENTS ? EVENTS + 1 : 0) };

typedef struct {
    Queue q; /* of all */
    real *y, *final_y, *told, *moments;
    long block;
} Batch;

static void run_block(void *job, long part) {
    const Batch *all = job;
    const long first = part * all->block;
    Queue q = all->q;
    q.count = q.count - first < all->block ? q.count - first : all->block;
    q.starts += first * N, q.atol += first * N, q.own += first * OWN;
    q.first_steps += first;
    real *y = all->y + first * q.outputs * N, *told = all->told + first * TOLD;
    real *final_y = all->final_y + first * N;
    int64_t *steps = malloc(2 * q.count * sizeof *steps), *rejected = steps + q.count;
    real *final_time = malloc(q.count * sizeof *final_time);
    int32_t *code = malloc(q.count * sizeof *code);
    Results out = {y, code, final_time, final_y, steps, rejected};
#if EVENTS
    const long room = EVENT_CAPACITY * (1 + N);
    out.moments = all->moments + first * room;
    out.numbers = calloc(q.count * (EVENTS + 1), sizeof *out.numbers);
    for (long i = 0; i < q.count * room; i++) out.moments[i] = (real)NAN;
    for (long i = 0; i < q.count; i++) out.numbers[i * (EVENTS + 1) + EVENTS] = -1;
#endif
    for (long i = 0; i < q.count * q.outputs * N; i++) y[i] = (real)NAN;
    if (q.stops)
        integrate(&q, &out);
    else { /* no time to go to */
        memcpy(final_y, q.starts, q.count * N * sizeof *final_y);
        for (long i = 0; i < q.count; i++)
            code[i] = BAD_START, steps[i] = rejected[i] = 0, final_time[i] = q.time;
    }
    for (long i = 0; i < q.count; i++, told += TOLD) {
        told[0] = q.sense * final_time[i], told[1] = (real)code[i];
        told[2] = (real)steps[i], told[3] = (real)rejected[i];
#if EVENTS
        for (int e = 0; e <= EVENTS; e++) told[4 + e] = (real)out.numbers[i * (EVENTS + 1) + e];
#endif
    }
#if EVENTS
    free(out.numbers);
#endif
    free(steps), free(final_time), free(code);
}

static void run_batch(const Call *call, long b) {
    Batch all = {
        .q = queue_of(call, b, size_of(&call->given[FIRST_AT])),
        .y = wanted(call, 0, b),
        .final_y = wanted(call, 1, b),
        .told = wanted(call, 2, b),
#if EVENTS
        .moments = wanted(call, 3, b),
#endif
    };
    const long given = all.q.stops;
    int64_t *slots = malloc((given + 1) * sizeof *slots);
    real *ends = malloc(2 * (given + 1) * sizeof *ends);
    settle_stops(&all.q, member(call, TIMES_AT, b), ends, ends + given + 1, slots);
    /* some blocks for each, so that none waits long; long ones, as lanes idle at the end */
    const long count = all.q.count, fair = count / (4 * processors()) + 1;
    all.block = fair < 16 * LANES ? 16 * LANES : fair;
    in_parallel(run_block, &all, (count + all.block - 1) / all.block);
    free(slots), free(ends);
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 2, 2, 2, 1, 1, 1, 1, 1};
    Call call;
    if (!received(frame, axes, 3, &call)) return NULL;
    for (long b = 0; b < call.batch; b++) run_batch(&call, b); /* of a batch of batches */
    return NULL;
}
