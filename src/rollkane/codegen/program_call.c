/* A whole program, called from XLA; of a batch, one after the other on every processor.
 * Before this text: xla_call.h, program.h, the program and threads.h.
 */

OF_THE_PROGRAM int to_end_now(void) { return told_to_end(); }

static void run_member(void *job, long b) {
    const Call *call = job;
    Frame frame;
    for (long i = 0; i < MOST_GIVEN; i++) frame.given[i] = member(call, i, b);
    for (long i = 0; i < MOST_RESULTS; i++) frame.left[i] = wanted(call, i, b);
    frame.workspace = malloc((WORKSPACE + 1) * sizeof *frame.workspace);
    run(&frame);
    free(frame.workspace);
}

void *called_by_xla(const CallFrame *frame) {
    int axes[MOST_GIVEN];
    for (int i = 0; i < MOST_GIVEN; i++) axes[i] = 1;
    Call call;
    if (!received(frame, axes, 1, &call)) return NULL;
    in_parallel(run_member, &call, call.batch);
    return NULL;
}
