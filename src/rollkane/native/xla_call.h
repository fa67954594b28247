/* What XLA hands over in a call. Before this text: XLA's c_api.h and rows.h.
 *
 * Sizes that are no more than memory are read from the shapes of XLA's buffers. In a batch
 * each buffer has one more axis in front, of length one where all members share it.
 */

typedef struct {
    const char *data;
    const int64_t *dims;
    long leads, axes; /* axes of the batch in front, and its own */
} Buffer;

enum { MOST_GIVEN = 9, MOST_RESULTS = 5 }; /* of any function here */

typedef struct {
    Buffer given[MOST_GIVEN];
    char *results[MOST_RESULTS];
    long sizes[MOST_RESULTS];
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

/* The buffers, in the order of XLA's call, with how many axes are their own and the first
 * result's; 0 where only the interface's version is asked. */
static int received(XLA_FFI_CallFrame *frame, const int *axes, int result_axes, Call *call) {
    XLA_FFI_Extension_Base *asked = frame->extension_start;
    if (asked && asked->type == XLA_FFI_Extension_Metadata) {
        XLA_FFI_Metadata *told = ((XLA_FFI_Metadata_Extension *)asked)->metadata;
        told->api_version.struct_size = XLA_FFI_Api_Version_STRUCT_SIZE;
        told->api_version.major_version = XLA_FFI_API_MAJOR;
        told->api_version.minor_version = XLA_FFI_API_MINOR;
        return 0;
    }
    for (int i = 0; i < frame->args.size; i++) {
        const XLA_FFI_Buffer *b = frame->args.args[i];
        call->given[i] = (Buffer){b->data, b->dims, b->rank - axes[i], axes[i]};
    }
    const XLA_FFI_Buffer *result = frame->rets.rets[0];
    call->dims = result->dims;
    call->leads = result->rank - result_axes;
    call->batch = product(call->dims, call->leads);
    for (int i = 0; i < frame->rets.size; i++) {
        result = frame->rets.rets[i];
        call->results[i] = result->data;
        call->sizes[i] = product(result->dims + call->leads, result->rank - call->leads);
    }
    return 1;
}

/* Where a result of a member of the batch begins. */
static real *wanted(const Call *call, int i, long b) {
    return (real *)call->results[i] + b * call->sizes[i];
}
