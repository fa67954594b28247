/* Changes of one motion's states along the steps that it took, called from XLA. Before
 * this text: XLA's c_api.h, rows.h, and generated N (numbers of a state), SHARED (numbers
 * of what the rates depend on), MOVED (how many of them change), STAGES, NUMBERS and ROWS
 * (that prepare leaves for rates), and prepare, rates, advance.
 *
 * A row holds one number for each of LANES changes; where there are more, the motion is
 * gone through again for the next. Sizes that are no more than memory are read from the
 * shapes of XLA's buffers.
 */

/* of XLA's buffers, in their order; a batch has one more axis in front of each */
enum { SHARED_AT, MOVED_AT, Y_AT, DY_AT, RECORD_AT, COUNT_AT, SENSE_AT, OUTPUTS_AT, JUMPS_AT };

typedef struct {
    const real *shared;
    const row *moved;        /* [MOVED] */
    const real *y;           /* [N] */
    const row *dy;           /* [N] */
    const real *record;      /* where steps begin, and the last one ends */
    long count;              /* of steps */
    real sense;              /* 1, or -1 where time runs backwards */
    const real *times, *jumps;
    long outputs, jump_count;
    char *shown, *last;      /* rows, [outputs][N] and [N] */
} Task;

/* Where a step ends that reaches as far as the next begins: before a jump. */
static real end_of(const Task *task, real following) {
    for (long j = 0; j < task->jump_count; j++) {
        const real at = C(nextafter)(following, (real)-INFINITY);
        if (at == task->jumps[j]) return C(nextafter)(at, (real)-INFINITY);
    }
    return following;
}

static void show(const Task *task, long output, const row *dy) {
    memcpy(task->shown + output * N * BYTES, dy, N * BYTES);
}

static void push(const Task *task) {
    real u[NUMBERS + 1], y[N];
    row v[ROWS + 1], dy[N], unreached[N];
    const real sense = task->sense;
    long output = 1;
    prepare(task->shared, task->moved, u, v);
    memcpy(y, task->y, sizeof y);
    memcpy(dy, task->dy, sizeof dy);
    show(task, 0, dy);
    for (int c = 0; c < N; c++) unreached[c] = splat((real)NAN);
    for (long i = 1; i < task->outputs; i++) show(task, i, unreached);
    for (long i = 0; i < task->count; i++) {
        const real begin = sense * task->record[i];
        const real following = sense * task->record[i + 1];
        const real end = end_of(task, following);
        advance(sense * begin, sense * end, sense * (end - begin), y, dy, task->shared,
                task->moved, u, v);
        if (output >= task->outputs) continue;
        const real time = task->times[output];
        if (end <= time && time <= following) show(task, output++, dy);
    }
    memcpy(task->last, dy, sizeof dy);
}

static const XLA_FFI_Buffer *given(const XLA_FFI_CallFrame *frame, int i) {
    return frame->args.args[i];
}

static long size_of(const XLA_FFI_Buffer *buffer, int axes) {
    long size = 1;
    for (int i = 0; i < axes; i++) size *= buffer->dims[buffer->rank - axes + i];
    return size;
}

XLA_FFI_Error *push_from_xla(XLA_FFI_CallFrame *frame) {
    XLA_FFI_Extension_Base *asked = frame->extension_start;
    if (asked && asked->type == XLA_FFI_Extension_Metadata) {
        XLA_FFI_Metadata *told = ((XLA_FFI_Metadata_Extension *)asked)->metadata;
        told->api_version.struct_size = XLA_FFI_Api_Version_STRUCT_SIZE;
        told->api_version.major_version = XLA_FFI_API_MAJOR;
        told->api_version.minor_version = XLA_FFI_API_MINOR;
        return NULL;
    }
    const long batch = size_of(given(frame, COUNT_AT), given(frame, COUNT_AT)->rank);
    const long groups = given(frame, DY_AT)->dims[given(frame, DY_AT)->rank - 3];
    const long records = size_of(given(frame, RECORD_AT), 1);
    const long outputs = size_of(given(frame, OUTPUTS_AT), 1);
    const long jumps = size_of(given(frame, JUMPS_AT), 1);
    const real *from[JUMPS_AT + 1];
    char *to[2];
    row moved[MOVED + 1], dy[N];
    for (int i = 0; i <= JUMPS_AT; i++) from[i] = given(frame, i)->data;
    for (int i = 0; i < 2; i++) to[i] = ((XLA_FFI_Buffer *)frame->rets.rets[i])->data;
    for (long b = 0; b < batch; b++)
        for (long g = b * groups; g < (b + 1) * groups; g++) {
            /* XLA's buffers need not begin where rows may */
            memcpy(moved, from[MOVED_AT] + g * MOVED * LANES, MOVED * sizeof(row));
            memcpy(dy, from[DY_AT] + g * N * LANES, sizeof dy);
            const Task task = {
                .shared = from[SHARED_AT] + b * SHARED,
                .moved = moved,
                .y = from[Y_AT] + b * N,
                .dy = dy,
                .record = from[RECORD_AT] + b * records,
                .count = (long)from[COUNT_AT][b],
                .sense = from[SENSE_AT][b],
                .times = from[OUTPUTS_AT] + b * outputs,
                .jumps = from[JUMPS_AT] + b * jumps,
                .outputs = outputs,
                .jump_count = jumps,
                .shown = to[0] + g * outputs * N * BYTES,
                .last = to[1] + g * N * BYTES,
            };
            push(&task);
        }
    return NULL;
}
