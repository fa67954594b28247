/* What the other texts are written with on a GPU, in NVRTC's C++. Before this text: rows of one
 * number, and generated BLOCK (threads of one, at most).
 */
#define ON_DEVICE 1
#define LOCAL
#define restrict __restrict__

#define KERNEL(name)                                                                   \
    extern "C" __global__ void __launch_bounds__(BLOCK, 1)                             \
    name(const __grid_constant__ Sent sent)
#define OF_BLOCK __shared__ /* one for all threads of a block */
#define FIRST_OF_BLOCK (threadIdx.x == 0)
#define TOGETHER() __syncthreads()
/* a thread's number; blocks have two axes, the second one of members of a batch */
#define THREAD ((long)blockIdx.x * blockDim.x + threadIdx.x)
#define THREADS ((long)gridDim.x * blockDim.x)
#define BATCH_ROW ((long)blockIdx.y)
#define BATCH_ROWS ((long)gridDim.y)

/* How many of a queue are taken; the next one's number. */
typedef unsigned long long Taken;
static __forceinline__ long next_of(Taken *taken) { return (long)atomicAdd(taken, 1ull); }

/* Nobody looks at a run there, or ends it. */
#define told_to_end() 0
#define tell_time(time) (void)(time)
