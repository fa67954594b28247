/* The queue of motions that a call from XLA asks for. Before this text: xla_call.h and
 * lane_loop.c.
 */

enum { SHARED_AT, OWN_AT, Y_AT, ATOL_AT, FIRST_AT, NUMBERS_AT, ENDS_AT, BEGINS_AT,
       TIMES_AT };

/* That of a member of a batch: so many motions, whose stops are yet to be settled. */
static Queue queue_of(const Call *call, long b, long count) {
    const real *numbers = member(call, NUMBERS_AT, b);
    return (Queue){
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
        .time = numbers[0],
        .sense = numbers[1],
        .rtol = numbers[2],
        .dtmin = numbers[3],
        .dtmax = numbers[5],
        .max_steps = (int64_t)numbers[4],
    };
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
