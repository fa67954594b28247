/* Changes of motions' states along their steps, called from XLA; all on every processor.
 * Before this text: xla_call.h, threads.h and tangent_loop.c.
 */

static void push_part(void *job, long part) {
    const Call *call = job;
    push_row(call, part / groups_of(call), part % groups_of(call), 0);
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 3, 1, 3, 1, 0, 0, 1, 2};
    Call call;
    if (!received(frame, axes, 4, &call)) return NULL;
    in_parallel(push_part, &call, call.batch * groups_of(&call));
    return NULL;
}
