/* Cotangents of motions' states on a GPU, a thread for each motion. Before this text: device.h,
 * device_call.h and cotangent_loop.c. */

KERNEL(work) {
    const Call call = arrived(&sent);
    for (long b = THREAD; b < call.batch; b += THREADS) pull_member(&call, b);
}
