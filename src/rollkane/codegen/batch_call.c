/* A batch of motions in the loop over lanes, called from XLA: blocks of it on every
 * processor. Before this text: xla_call.h, lane_loop.c, queue.h and threads.h.
 */

typedef struct {
    Queue q; /* of all */
    Results out;
    long block;
} Batch;

static void run_block(void *job, long part) {
    const Batch *all = job;
    const long first = part * all->block;
    Queue q = all->q;
    Results out = all->out;
    q.count = q.count - first < all->block ? q.count - first : all->block;
    q.starts += first * N, q.atol += first * N, q.own += first * OWN;
    q.first_steps += first, q.longest += first;
    out.y += first * q.outputs * N, out.final_y += first * N, out.told += first * TOLD;
#if EVENTS
    out.moments += first * EVENT_CAPACITY * (1 + N);
#endif
#if RECORD
    out.record += first * (q.max_steps + 1);
    out.kept += first * (q.max_steps / BETWEEN + 1) * N;
#endif
    if (q.stops) integrate(&q, &out);
    else stand_still(&q, &out);
}

static void run_batch(const Call *call, long b) {
    const long count = size_of(&call->given[FIRST_AT]);
    Batch all = {.q = queue_of(call, b, count), .out = results_of(call, b)};
    const long given = all.q.stops;
    int64_t *slots = malloc((given + 1) * sizeof *slots);
    real *ends = malloc(2 * (given + 1) * sizeof *ends);
    settle_stops(&all.q, member(call, TIMES_AT, b), ends, ends + given + 1, slots);
    /* some blocks for each, so that none waits long; long ones, as lanes idle at the end */
    const long fair = count / (4 * processors()) + 1;
    all.block = fair < 16 * LANES ? 16 * LANES : fair;
    in_parallel(run_block, &all, (count + all.block - 1) / all.block);
    free(slots), free(ends);
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 2, 2, 2, 1, 1, 1, 1, 1, 1};
    Call call;
    if (!received(frame, axes, 3, &call)) return NULL;
    for (long b = 0; b < call.batch; b++) run_batch(&call, b); /* of a batch of batches */
    return NULL;
}
