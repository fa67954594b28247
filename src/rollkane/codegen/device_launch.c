/* A function of a GPU, called from XLA: put on its stream. Before this text: xla_call.h,
 * device_call.h, and generated GIVEN (arguments), AXES (their own), RESULT_AXES (the first
 * result's), SPREAD_AT and SPREAD_BY (an argument, and by how many of a member's numbers of it
 * there is a thread), WORKSPACE_AT (the result that is one, or -1), BY_MEMBERS (whether members
 * of a batch have blocks of their own), BLOCK (threads of one, at most) and HAS_BEFORE (whether
 * another function has to be through before).
 *
 * CUDA's driver is what JAX has loaded; its functions are declared here by what they take.
 */

#include <dlfcn.h>
#include <stdio.h>

typedef int Status;
enum { PROCESSORS = 16, LONGEST = 300 }; /* a device's attribute; of what is told */

static struct {
    Status (*init)(unsigned flags);
    Status (*name_of)(Status status, const char **name);
    Status (*load)(void **library, const void *image, void *, void *, unsigned, void *, void *,
                   unsigned);
    Status (*kernel)(void **kernel, void *library, const char *name);
    Status (*function)(void **function, void *kernel);
    Status (*context_of)(void *stream, void **context);
    Status (*push)(void *context);
    Status (*pop)(void **context);
    Status (*device)(int *device);
    Status (*attribute)(int *value, int attribute, int device);
    Status (*resident)(int *blocks, void *function, int threads, size_t shared);
    Status (*launch)(void *function, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned,
                     unsigned shared, void *stream, void **given, void **more);
} cuda;
static void *work, *before; /* kernels, once they are loaded */
static char failed[LONGEST];

static int fails(Status status, const char *doing) {
    const char *name = NULL;
    if (!status) return 0;
    if (cuda.name_of) cuda.name_of(status, &name);
    snprintf(failed, sizeof failed, "the GPU's driver fails to %s: %s (%d)", doing,
             name ? name : "an unknown error", status);
    return 1;
}

/* Load the functions from what their compiler made; NULL, or why that cannot be. */
const char *load_image(const void *image) {
    static const struct {
        void **place;
        const char *name;
    } known[] = {
        {(void **)&cuda.init, "cuInit"},
        {(void **)&cuda.name_of, "cuGetErrorName"},
        {(void **)&cuda.load, "cuLibraryLoadData"},
        {(void **)&cuda.kernel, "cuLibraryGetKernel"},
        {(void **)&cuda.function, "cuKernelGetFunction"},
        {(void **)&cuda.context_of, "cuStreamGetCtx"},
        {(void **)&cuda.push, "cuCtxPushCurrent_v2"},
        {(void **)&cuda.pop, "cuCtxPopCurrent_v2"},
        {(void **)&cuda.device, "cuCtxGetDevice"},
        {(void **)&cuda.attribute, "cuDeviceGetAttribute"},
        {(void **)&cuda.resident, "cuOccupancyMaxActiveBlocksPerMultiprocessor"},
        {(void **)&cuda.launch, "cuLaunchKernel"},
    };
    void *driver = dlopen(CUDA_DRIVER, RTLD_NOW), *library;
    if (!driver) return "the GPU's driver (" CUDA_DRIVER ") cannot be loaded";
    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        *known[i].place = dlsym(driver, known[i].name);
        if (*known[i].place) continue;
        snprintf(failed, sizeof failed, "the GPU's driver has no %s: it is older than CUDA 12",
                 known[i].name);
        return failed;
    }
    if (fails(cuda.init(0), "start") ||
        fails(cuda.load(&library, image, NULL, NULL, 0, NULL, NULL, 0), "load a program") ||
        (HAS_BEFORE && fails(cuda.kernel(&before, library, "before"), "find a function")) ||
        fails(cuda.kernel(&work, library, "work"), "find a function"))
        return failed;
    return NULL;
}

/* So many threads, or as many as are at work at once, on all of the GPU's processors. */
static Status launch(void *kernel, long threads, long rows, void *stream, Sent *sent) {
    void *function, *given[] = {sent};
    int device, processors, resident;
    if (threads < 1) return 0;
    Status status = cuda.function(&function, kernel);
    if (!status) status = cuda.device(&device);
    if (!status) status = cuda.attribute(&processors, PROCESSORS, device);
    if (status) return status;
    long block = (threads * rows + processors - 1) / processors;
    block = (block + 31) / 32 * 32; /* whole warps */
    block = block > BLOCK ? BLOCK : block;
    status = cuda.resident(&resident, function, (int)block, 0);
    if (status) return status;
    const long most = (long)resident * processors / (rows < 1 ? 1 : rows);
    long blocks = (threads + block - 1) / block;
    blocks = blocks > most ? most : blocks;
    return cuda.launch(function, blocks < 1 ? 1 : (unsigned)blocks, (unsigned)rows, 1,
                       (unsigned)block, 1, 1, 0, stream, given, NULL);
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {AXES};
    Sent sent;
    memset(&sent, 0, sizeof sent);
    if (!received(frame, axes, RESULT_AXES, &sent.call)) return NULL;
    const Call *call = &sent.call;
    if (!call->batch) return NULL;
    int fits = call->leads <= MOST_AXES;
    for (int i = 0; i < GIVEN; i++) {
        const Buffer *buffer = &call->given[i];
        fits &= buffer->leads + buffer->axes <= MOST_AXES;
        for (long axis = 0; fits && axis < buffer->leads + buffer->axes; axis++)
            sent.dims[i][axis] = buffer->dims[axis];
    }
    for (long axis = 0; fits && axis < call->leads; axis++)
        sent.dims[MOST_GIVEN][axis] = call->dims[axis];
    sent.parts = size_of(&call->given[SPREAD_AT]) / SPREAD_BY, sent.workspace = WORKSPACE_AT;
    StreamAsked asked = {sizeof asked, NULL, frame->context, NULL};
    char why[LONGEST] = "batches of batches of this depth are not run on a GPU";
    void *error = fits ? frame->api->stream_get(&asked) : NULL;
    if (error) return error;
    if (fits) {
        void *context;
        Status status = cuda.context_of(asked.stream, &context);
        if (!status) status = cuda.push(context);
        if (!status) {
            long threads = sent.parts * call->batch, rows = 1;
            if (BY_MEMBERS) {
                rows = call->batch > 65535 ? 65535 : call->batch;
                threads = sent.parts;
            }
            if (HAS_BEFORE) status = launch(before, call->batch, 1, asked.stream, &sent);
            if (!status) status = launch(work, threads, rows, asked.stream, &sent);
            cuda.pop(&context);
        }
        if (!status) return NULL;
        const char *name = NULL;
        cuda.name_of(status, &name);
        snprintf(why, sizeof why, "the GPU did not take a run: %s (%d)",
                 name ? name : "an unknown error", status);
    }
    ErrorAsked told = {sizeof told, NULL, why, INTERNAL};
    return frame->api->error_create(&told);
}
