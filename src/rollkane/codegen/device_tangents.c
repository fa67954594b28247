/* Changes of motions' states along their steps on a GPU, a thread for each change. Before this
 * text: device.h, device_call.h, and tangent_loop.c with SPREAD. */

KERNEL(work) {
    const Call call = arrived(&sent);
    const long rows = groups_of(&call), every = call.batch * rows * SPREAD;
    for (long i = THREAD; i < every; i += THREADS) {
        const long row = i / SPREAD;
        push_row(&call, row / rows, row % rows, i % SPREAD);
    }
}
