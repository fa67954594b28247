/* What XLA hands over in a call. Before this text: rows.h, and API_MAJOR and API_MINOR, the
 * version of the installed interface.
 *
 * XLA's structures are declared here by their layout, which an API of one major version
 * only appends to (each structure tells its size); the names in its header change from
 * release to release. xla_call.py compares layouts with the installed header.
 *
 * Sizes that are no more than memory are read from the shapes of XLA's buffers. In a batch
 * each buffer has one more axis in front, of length one where all members share it.
 */

typedef struct Extension {
    size_t struct_size;
    int type;
    struct Extension *next;
} Extension;

typedef struct {
    size_t struct_size;
    Extension *extension_start;
    int major_version, minor_version;
} ApiVersion;

typedef struct {
    size_t struct_size;
    ApiVersion api_version;
} Metadata; /* its first fields */

typedef struct {
    Extension extension_base;
    Metadata *metadata;
} MetadataExtension;

typedef struct {
    size_t struct_size;
    Extension *extension_start;
    int dtype;
    void *data;
    int64_t rank;
    int64_t *dims;
} XlaBuffer;

typedef struct {
    size_t struct_size;
    Extension *extension_start;
    int64_t size;
    int *types;
    void **items;
} XlaBuffers;

typedef struct {
    size_t struct_size;
    Extension *extension_start;
    const char *message;
    int code;
} ErrorAsked;

typedef struct {
    size_t struct_size;
    Extension *extension_start;
    ApiVersion api_version;
    const void *internal;
    void *(*error_create)(ErrorAsked *asked);
} Api; /* its first fields */

typedef struct {
    size_t struct_size;
    Extension *extension_start;
    const Api *api;
    const void *context;
    int stage;
    XlaBuffers args, rets;
} CallFrame; /* its first fields */

enum { METADATA = 1 };  /* the type of an extension that asks for the version */
enum { INTERNAL = 13 }; /* the code of an error */

typedef struct {
    const char *data;
    const int64_t *dims;
    long leads, axes; /* axes of the batch in front, and its own */
} Buffer;

#ifndef MOST_GIVEN /* arguments and results of any function here */
#define MOST_GIVEN 9
#define MOST_RESULTS 5
#endif

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

/* The first member from b on, before an end, that does not share an argument with b. */
INLINE long behind_alike(const Call *call, int i, long b, long end) {
    const real *theirs = member(call, i, b);
    while (b < end && member(call, i, b) == theirs) b++;
    return b;
}

/* Whether only the interface's version is asked, which is told then. */
static int told_version(const CallFrame *frame) {
    const Extension *asked = frame->extension_start;
    if (!asked || asked->type != METADATA) return 0;
    ApiVersion *told = &((const MetadataExtension *)asked)->metadata->api_version;
    told->struct_size = sizeof *told;
    told->major_version = API_MAJOR;
    told->minor_version = API_MINOR;
    return 1;
}

/* The buffers, in the order of XLA's call, with how many axes are their own and the first
 * result's; 0 where only the interface's version is asked. */
static int received(const CallFrame *frame, const int *axes, int result_axes, Call *call) {
    if (told_version(frame)) return 0;
    for (int i = 0; i < frame->args.size; i++) {
        const XlaBuffer *b = frame->args.items[i];
        call->given[i] = (Buffer){b->data, b->dims, b->rank - axes[i], axes[i]};
    }
    const XlaBuffer *result = frame->rets.items[0];
    call->dims = result->dims;
    call->leads = result->rank - result_axes;
    call->batch = product(call->dims, call->leads);
    for (int i = 0; i < frame->rets.size; i++) {
        result = frame->rets.items[i];
        call->results[i] = result->data;
        call->sizes[i] = product(result->dims + call->leads, result->rank - call->leads);
    }
    return 1;
}

/* Where a result of a member of the batch begins. */
static real *wanted(const Call *call, int i, long b) {
    return (real *)call->results[i] + b * call->sizes[i];
}
