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
