/* Cotangents of a motion's states, called from XLA; of a batch on every processor. Before this
 * text: xla_call.h, threads.h and cotangent_loop.c, of motions whose numbers are all shared.
 */

static void pull_part(void *call, long b) { pull_member(call, b); }

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 2, 2, 1, 1, 0, 0, 1, 2};
    Call call;
    if (!received(frame, axes, 1, &call)) return NULL;
    in_parallel(pull_part, &call, call.batch);
    return NULL;
}
