/* What XLA hands over in a call. Before this text: buffers.h, and API_MAJOR and API_MINOR,
 * the version of the installed interface.
 *
 * XLA's structures are declared here by their layout, which an API of one major version
 * only appends to (each structure tells its size); the names in its header change from
 * release to release. xla_call.py compares layouts with the installed header.
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
    const void *context;
    void *stream; /* what is asked */
} StreamAsked;

typedef struct {
    size_t struct_size;
    Extension *extension_start;
    ApiVersion api_version;
    const void *internal;
    void *(*error_create)(ErrorAsked *asked);
    void *(*error_message)(void *), *(*error_destroy)(void *), *(*handler_register)(void *);
    void *(*stream_get)(StreamAsked *asked);
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
