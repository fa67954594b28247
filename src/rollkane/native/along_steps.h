/* A motion's steps, and what XLA hands over of them. Before this text: XLA's c_api.h,
 * rows.h, and generated N (numbers of a state) and BUFFERS (that XLA gives).
 *
 * Sizes that are no more than memory are read from the shapes of XLA's buffers. In a batch
 * each buffer has one more axis in front, of length one where all members share it.
 */

typedef struct {
    const real *record; /* where steps begin, and the last one ends */
    long count;         /* of steps */
    real sense;         /* 1, or -1 where time runs backwards */
    const real *outputs, *jumps;
    long output_count, jump_count;
} Way;

typedef struct {
    real begin, end, following; /* where it begins, ends, and where the next begins */
} Step;

/* A step; time runs forwards in it. One that ends before a jump is told by where the next
 * begins: behind it. */
static Step step_of(const Way *way, long i) {
    const real begin = way->sense * way->record[i];
    const real following = way->sense * way->record[i + 1];
    for (long j = 0; j < way->jump_count; j++) {
        const real at = C(nextafter)(following, (real)-INFINITY);
        if (at == way->jumps[j])
            return (Step){begin, C(nextafter)(at, (real)-INFINITY), following};
    }
    return (Step){begin, following, following};
}

static int shows(const Way *way, Step step, long output) {
    const real time = way->outputs[output];
    return step.end <= time && time <= step.following;
}

typedef struct {
    const char *data;
    const int64_t *dims;
    long leads, axes; /* axes of the batch in front, and its own */
} Buffer;

typedef struct {
    Buffer given[BUFFERS];
    char *results[2];
    const int64_t *dims; /* of the batch */
    long leads, batch;
} Call;

static long product(const int64_t *dims, long axes) {
    long size = 1;
    for (long i = 0; i < axes; i++) size *= dims[i];
    return size;
}

static long size_of(const Buffer *buffer) {
    return product(buffer->dims + buffer->leads, buffer->axes);
}

/* Where the numbers of a member of the batch begin. */
static const real *member(const Call *call, int i, long b) {
    const Buffer *buffer = &call->given[i];
    long place = 0, stride = size_of(buffer);
    for (long axis = call->leads - 1; axis >= 0; axis--) {
        const long at = b % call->dims[axis];
        b /= call->dims[axis];
        if (buffer->dims[axis] > 1) place += at * stride;
        stride *= buffer->dims[axis];
    }
    return (const real *)buffer->data + place;
}

/* The buffers, in the order of XLA's call; 0 where only the interface's version is asked.
 * Steps are those from `first` on: their record, count, sense, outputs and jumps. */
static int received(XLA_FFI_CallFrame *frame, const int *axes, int result_axes, Call *call) {
    XLA_FFI_Extension_Base *asked = frame->extension_start;
    if (asked && asked->type == XLA_FFI_Extension_Metadata) {
        XLA_FFI_Metadata *told = ((XLA_FFI_Metadata_Extension *)asked)->metadata;
        told->api_version.struct_size = XLA_FFI_Api_Version_STRUCT_SIZE;
        told->api_version.major_version = XLA_FFI_API_MAJOR;
        told->api_version.minor_version = XLA_FFI_API_MINOR;
        return 0;
    }
    for (int i = 0; i < BUFFERS; i++) {
        const XLA_FFI_Buffer *b = frame->args.args[i];
        call->given[i] = (Buffer){b->data, b->dims, b->rank - axes[i], axes[i]};
    }
    for (int i = 0; i < 2; i++)
        call->results[i] = ((XLA_FFI_Buffer *)frame->rets.rets[i])->data;
    const XLA_FFI_Buffer *result = frame->rets.rets[0];
    call->dims = result->dims;
    call->leads = result->rank - result_axes;
    call->batch = product(call->dims, call->leads);
    return 1;
}

static Way way_of(const Call *call, int first, long b) {
    return (Way){
        .record = member(call, first, b),
        .count = (long)*member(call, first + 1, b),
        .sense = *member(call, first + 2, b),
        .outputs = member(call, first + 3, b),
        .output_count = size_of(&call->given[first + 3]),
        .jumps = member(call, first + 4, b),
        .jump_count = size_of(&call->given[first + 4]),
    };
}
