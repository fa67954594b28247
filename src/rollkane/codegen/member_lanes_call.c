/* Blocks of a batch of runs in modes on every processor. Before this text: member_lanes.c
 * and, for each mode, plain_steps.c; RUN_MODES runs the lanes of one.
 */

typedef struct {
    const Call *call;
    long block;
} Batch;

/* Members that share all that is shared. */
static void run_alike(Block *b) {
    for (int m = 0; m < MODES; m++) b->waiting[m] = 0;
    for (long i = 0; i < b->count; i++) {
        memcpy(b->small + i * GIVEN_SMALL, member(b->call, 0, b->first + i),
               GIVEN_SMALL * sizeof(real));
        const int mode = decide(b, i, 1);
        if (mode >= 0) b->queue[mode][b->waiting[mode]++] = i;
    }
    for (int some = 1; some;) {
        some = 0;
        for (int m = 0; m < MODES; m++)
            if (b->waiting[m] > 0) run_mode[m](b), some = 1;
    }
}

static void run_block(void *job, long part) {
    const Batch *all = job;
    const long first = part * all->block, left = all->call->batch - first;
    const long count = left < all->block ? left : all->block;
    Block b = {.call = all->call};
    b.small = malloc(count * GIVEN_SMALL * sizeof *b.small);
    b.workspace = malloc((WORKSPACE + 1) * sizeof *b.workspace);
    long *queues = malloc(MODES * count * sizeof *queues);
    for (int m = 0; m < MODES; m++) b.queue[m] = queues + m * count;
    for (long i = 0; i < count; i += b.count) { /* of a batch of batches */
        b.first = first + i;
        b.shared = member(b.call, SHARED_AT, b.first);
        b.count = behind_alike(b.call, SHARED_AT, b.first, first + count) - b.first;
        run_alike(&b);
    }
    free(queues), free(b.workspace), free(b.small);
}

void *called_by_xla(const CallFrame *frame) {
    int axes[MOST_GIVEN];
    for (int i = 0; i < MOST_GIVEN; i++) axes[i] = 1;
    Call call;
    if (!received(frame, axes, 1, &call)) return NULL;
    /* some blocks for each, so that none waits long; long ones, as lanes idle at the end */
    const long fair = call.batch / (4 * processors()) + 1;
    Batch all = {&call, fair < 16 * LANES ? 16 * LANES : fair};
    in_parallel(run_block, &all, (call.batch + all.block - 1) / all.block);
    return NULL;
}
