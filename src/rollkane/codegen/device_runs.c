/* Motions on a GPU, a thread for each that is under way. Before this text: device.h,
 * lane_loop.c with one lane, queue.h and device_call.h.
 *
 * A queue is a member of the batch: of one motion where ALONE, which each has numbers of its
 * own; else of many, which share what is prepared for them. Where they are SORTED, the longest
 * come first: those of a warp end about together, and few wait for others.
 */

typedef struct {
    Taken taken;
    int64_t stops;
} Begun;

/* A member's part of the workspace: Begun, slots, ends and begins of so many stops. */
INLINE Begun *begun_of(const Call *call, const Sent *sent, long b) {
    return (Begun *)wanted(call, sent->workspace, b);
}

/* A queue whose stops are where the function before has left them. */
static Queue begun_queue(const Call *call, const Sent *sent, long b) {
    Queue q = queue_of(call, b, sent->parts);
    Begun *begun = begun_of(call, sent, b);
    int64_t *slots = (int64_t *)(begun + 1);
    real *ends = (real *)(slots + q.stops + 1);
    q.slots = slots, q.ends = ends, q.begins = ends + q.stops + 1;
    q.stops = begun->stops, q.taken = &begun->taken, q.order = NULL;
#if SORTED
    q.order = (const int32_t *)call->given[ORDER_AT].data + before_member(call, ORDER_AT, b);
#endif
    return q;
}

KERNEL(before) {
    const Call call = arrived(&sent);
    for (long b = THREAD; b < call.batch; b += THREADS) {
        Queue q = queue_of(&call, b, sent.parts);
        Begun *begun = begun_of(&call, &sent, b);
        int64_t *slots = (int64_t *)(begun + 1);
        real *ends = (real *)(slots + q.stops + 1), *begins = ends + q.stops + 1;
        settle_stops(&q, member(&call, TIMES_AT, b), ends, begins, slots);
        begun->taken = 0, begun->stops = q.stops;
    }
}

KERNEL(work) {
    const Call call = arrived(&sent);
#if ALONE
    for (long b = THREAD; b < call.batch; b += THREADS) {
        Prepared p;
#else
    OF_BLOCK Prepared p;
    for (long b = BATCH_ROW; b < call.batch; b += BATCH_ROWS) {
#endif
        const Queue q = begun_queue(&call, &sent, b);
        const Results out = results_of(&call, b);
#if ALONE
        prepare_all(q.shared, &p);
#else
        TOGETHER(); /* none is behind, in the numbers of the member before */
        if (FIRST_OF_BLOCK) prepare_all(q.shared, &p);
        TOGETHER();
#endif
        if (q.stops) run_lanes(&q, &p, &out);
        else if (ALONE || THREAD == 0) stand_still(&q, &out);
    }
}
