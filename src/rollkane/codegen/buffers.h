/* XLA's buffers in a call. Before this text: rows.h.
 *
 * Sizes that are no more than memory are read from the shapes of XLA's buffers. In a batch
 * each buffer has one more axis in front, of length one where all members share it.
 */

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

INLINE long product(const int64_t *dims, long axes) {
    long size = 1;
    for (long i = 0; i < axes; i++) size *= dims[i];
    return size;
}

INLINE long size_of(const Buffer *buffer) {
    return product(buffer->dims + buffer->leads, buffer->axes);
}

/* How many of an argument's numbers are before those of a member of the batch. */
INLINE long before_member(const Call *call, int i, long b) {
    const Buffer *buffer = &call->given[i];
    long place = 0, stride = size_of(buffer);
    for (long axis = call->leads - 1; axis >= 0; axis--) {
        const long at = b % call->dims[axis];
        b /= call->dims[axis];
        if (buffer->dims[axis] > 1) place += at * stride;
        stride *= buffer->dims[axis];
    }
    return place;
}

/* Where the numbers of a member of the batch begin. */
INLINE const real *member(const Call *call, int i, long b) {
    return (const real *)call->given[i].data + before_member(call, i, b);
}

/* The first member from b on, before an end, that does not share an argument with b. */
INLINE long behind_alike(const Call *call, int i, long b, long end) {
    const real *theirs = member(call, i, b);
    while (b < end && member(call, i, b) == theirs) b++;
    return b;
}

/* Where a result of a member of the batch begins. */
INLINE real *wanted(const Call *call, int i, long b) {
    return (real *)call->results[i] + b * call->sizes[i];
}
