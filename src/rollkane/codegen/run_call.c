/* One motion in the loop over lanes, called from XLA; of a batch, one after the other on
 * every processor. Before this text: xla_call.h, lane_loop.c with one lane, queue.h and
 * threads.h.
 */

static void run_member(void *job, long b) {
    const Call *call = job;
    Queue q = queue_of(call, b, 1);
    const Results out = results_of(call, b);
    const long given = q.stops;
    int64_t *slots = malloc((given + 1) * sizeof *slots);
    real *ends = malloc(2 * (given + 1) * sizeof *ends);
    settle_stops(&q, member(call, TIMES_AT, b), ends, ends + given + 1, slots);
    if (q.stops) integrate(&q, &out);
    else stand_still(&q, &out);
    free(slots), free(ends);
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
    Call call;
    if (!received(frame, axes, 2, &call)) return NULL;
    in_parallel(run_member, &call, call.batch);
    return NULL;
}
