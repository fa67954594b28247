/* What a GPU's function is told of a call from XLA. Before this text: buffers.h. */

enum { MOST_AXES = 8 };

typedef struct {
    Call call; /* whose lists of sizes are those behind it, wherever it is */
    int64_t dims[MOST_GIVEN + 1][MOST_AXES];
    long parts, workspace; /* of a member: threads; the result behind the others, or -1 */
} Sent;

/* The call, where it has arrived. */
INLINE Call arrived(const Sent *sent) {
    Call call = sent->call;
    for (int i = 0; i < MOST_GIVEN; i++) call.given[i].dims = sent->dims[i];
    call.dims = sent->dims[MOST_GIVEN];
    return call;
}
