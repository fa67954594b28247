/* A motion's steps. Before this text: buffers.h. */

typedef struct {
    const real *record; /* where steps begin, and the last one ends */
    long count;         /* of steps */
    real sense;         /* 1, or -1 where time runs backwards */
    const real *outputs;
    long output_count;
    const real *ends, *behind; /* ends of steps, begins of the next: jumps */
    long jump_count;
} Way;

typedef struct {
    real begin, end, following; /* where it begins, ends, and where the next begins */
} Step;

/* A step; time runs forwards in it. One that ends before a jump is told by where the next
 * begins: behind it. */
static Step step_of(const Way *way, long i) {
    const real begin = way->sense * way->record[i];
    const real following = way->sense * way->record[i + 1];
    long low = 0, high = way->jump_count; /* of the first that does not begin before */
    while (low < high) {
        const long middle = (low + high) / 2;
        if (way->behind[middle] < following) low = middle + 1;
        else high = middle;
    }
    const int jumps = low < way->jump_count && way->behind[low] == following;
    const Step step = {begin, jumps ? way->ends[low] : following, following};
    return step;
}

/* Of outputs at one time, the last; only it is shown. */
static long last_of(const Way *way, long output) {
    while (output + 1 < way->output_count &&
           way->outputs[output + 1] == way->outputs[output])
        output++;
    return output;
}

static int shows(const Way *way, Step step, long output) {
    const real time = way->outputs[output];
    return step.end <= time && time <= step.following;
}

/* Of a member of the batch, from XLA's buffers from the first of them on. */
static Way way_of(const Call *call, int first, long b) {
    const Way way = {
        .record = member(call, first, b),
        .count = (long)*member(call, first + 1, b),
        .sense = *member(call, first + 2, b),
        .outputs = member(call, first + 3, b),
        .output_count = size_of(&call->given[first + 3]),
        .ends = member(call, first + 4, b),
        .behind = member(call, first + 4, b) + size_of(&call->given[first + 4]) / 2,
        .jump_count = size_of(&call->given[first + 4]) / 2,
    };
    return way;
}
