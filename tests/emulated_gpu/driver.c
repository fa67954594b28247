/* What rollkane calls of CUDA's driver, for kernels that run on the processor: an image is the
 * name of a library, a kernel a function in it. */
#include <dlfcn.h>
#include <stddef.h>

struct Emulated {
    long thread, threads, block, row, rows;
};
typedef struct {
    void (*run)(const void *);
    struct Emulated *where;
} Kernel;
static Kernel kernels[1024];
static int known;

int cuInit(unsigned flags) { return flags != 0; }
int cuGetErrorName(int status, const char **name) { return *name = "EMULATED", status == 0; }
int cuLibraryLoadData(void **library, const char *image, void *a, void *b, unsigned c, void *d,
                      void *e, unsigned f) {
    *library = dlopen(image, RTLD_NOW | RTLD_LOCAL);
    return *library ? 0 : 200;
}
int cuLibraryGetKernel(void **kernel, void *library, const char *name) {
    Kernel *k = &kernels[known++];
    *(void **)&k->run = dlsym(library, name);
    k->where = dlsym(library, "emulated");
    *kernel = k;
    return k->run && k->where ? 0 : 500;
}
int cuKernelGetFunction(void **function, void *kernel) { return *function = kernel, 0; }
int cuStreamGetCtx(void *stream, void **context) { return *context = NULL, 0; }
int cuCtxPushCurrent_v2(void *context) { return 0; }
int cuCtxPopCurrent_v2(void **context) { return 0; }
int cuCtxGetDevice(int *device) { return *device = 0; }
int cuDeviceGetAttribute(int *value, int attribute, int device) { return *value = 2, 0; }
int cuOccupancyMaxActiveBlocksPerMultiprocessor(int *blocks, void *f, int threads, size_t s) {
    return *blocks = 1, 0;
}
int cuLaunchKernel(void *function, unsigned x, unsigned y, unsigned z, unsigned threads,
                   unsigned b, unsigned c, unsigned shared, void *stream, void **given,
                   void **more) {
    const Kernel *k = function;
    for (unsigned row = 0; row < y; row++)
        for (unsigned i = 0; i < x * threads; i++) {
            const struct Emulated here = {i, x * threads, threads, row, y};
            *k->where = here;
            k->run(given[0]);
        }
    return 0;
}
