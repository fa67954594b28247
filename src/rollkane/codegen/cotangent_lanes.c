/* Cotangents of many motions' states, back along their steps in lanes, called from XLA:
 * blocks of them on every processor. Before this text: along_steps.h, threads.h, and
 * generated VARIED (numbers that are asked for, apart from the state), OWN (numbers of the
 * model that differ), BETWEEN (steps from one recorded state to the next), STAGES, NUMBERS,
 * ROWS, BACK_NUMBERS and BACK_ROWS (that prepare and prepare_back leave), and prepare,
 * rates, prepare_back, rates_back, advance, retreat.
 *
 * As in cotangent_loop.c; all lanes go through a part of BETWEEN steps at once. One that
 * has fewer steps in its part stands still where the part begins: steps of no length.
 */

enum { SHARED_AT, OWN_AT, KEPT_AT, COTANGENTS_AT, LAST_AT, WAY_AT };

typedef struct {
    long at;             /* the motion; -1: none */
    Way way;
    long part, behind, output;
    const real *kept, *cotangents;
} Lane;

typedef struct {
    const Call *call;
    Lane lanes[LANES];
    row own[OWN + 1], back[N], of_varied[VARIED + 1];
} Lanes;

/* Take a motion into a lane. */
static void load(Lanes *a, int l, long b) {
    const Call *call = a->call;
    const real *own = member(call, OWN_AT, b), *last = member(call, LAST_AT, b);
    Lane *lane = &a->lanes[l];
    *lane = (Lane){.at = b, .way = way_of(call, WAY_AT, b)};
    const Way *way = &lane->way;
    lane->kept = member(call, KEPT_AT, b), lane->cotangents = member(call, COTANGENTS_AT, b);
    lane->part = (way->count + BETWEEN - 1) / BETWEEN - 1, lane->behind = way->count;
    if (way->count) {
        const real end = step_of(way, way->count - 1).following;
        while (lane->output + 1 < way->output_count && way->outputs[lane->output + 1] <= end)
            lane->output++;
    }
    for (int c = 0; c < OWN; c++) LANE(a->own[c], l) = own[c];
    for (int c = 0; c < N; c++) LANE(a->back[c], l) = last[c];
    for (int c = 0; c < VARIED; c++) LANE(a->of_varied[c], l) = 0;
}

/* Write what a lane has found, if it is at its motion's start. */
static void leave(Lanes *a, int l) {
    Lane *lane = &a->lanes[l];
    if (lane->at < 0 || lane->part >= 0) return;
    real *back = wanted(a->call, 0, lane->at), *of_varied = wanted(a->call, 1, lane->at);
    int lost = 0; /* an output that no step ended on leads nowhere known */
    for (long i = N; i < (lane->output + 1) * N; i++) lost |= lane->cotangents[i] != 0;
    for (int c = 0; c < N; c++) back[c] = lost ? (real)NAN : LANE(a->back[c], l);
    for (int c = 0; c < VARIED; c++)
        of_varied[c] = lost ? (real)NAN : LANE(a->of_varied[c], l);
    lane->at = -1;
}

/* Steps of a part that a lane has. */
INLINE long steps_of(const Lane *lane) {
    return lane->at < 0 ? 0 : lane->behind - lane->part * BETWEEN;
}

/* A lane's step of its part; behind the last one of no length, where the part begins. */
INLINE Step step_at(const Lane *lane, long i) {
    const long first = (lane->part > 0 ? lane->part : 0) * BETWEEN;
    if (i < steps_of(lane)) return step_of(&lane->way, first + i);
    const real begin = lane->way.sense * lane->way.record[first];
    return (Step){begin, begin, begin};
}

/* What outputs ask for at the end of a step. */
static void add_outputs(Lanes *a, int l, Step step) {
    Lane *lane = &a->lanes[l];
    const Way *way = &lane->way;
    if (!lane->output || !shows(way, step, lane->output)) return;
    for (int c = 0; c < N; c++) LANE(a->back[c], l) += lane->cotangents[lane->output * N + c];
    do lane->output--; /* of outputs at one time the last alone has one */
    while (lane->output && way->outputs[lane->output] == way->outputs[lane->output + 1]);
}

/* A step of each lane: when it begins, when it ends, and its length. */
INLINE void times_of(const Lanes *a, long i, row *t, row *t_end, row *h) {
    for (int l = 0; l < LANES; l++) {
        const Lane *lane = &a->lanes[l];
        const Step step = step_at(lane, i);
        const real s = lane->way.sense;
        LANE(*t, l) = s * step.begin, LANE(*t_end, l) = s * step.end;
        LANE(*h, l) = s * (step.end - step.begin);
    }
}

/* All lanes back through a part of their steps. */
static void pull_part(Lanes *a, const real *shared, const real *u, const row *v,
                      const real *w, const row *x) {
    row y[BETWEEN][N], k[BETWEEN][STAGES][N], now[N], begin[N], t, t_end, h;
    long longest = 0;
    for (int l = 0; l < LANES; l++) {
        const Lane *lane = &a->lanes[l];
        const real *kept = lane->kept + (lane->part > 0 ? lane->part : 0) * N;
        for (int c = 0; c < N; c++) LANE(begin[c], l) = kept[c];
        longest = steps_of(lane) > longest ? steps_of(lane) : longest;
    }
    memcpy(now, begin, sizeof now);
    for (long i = 0; i < longest; i++) {
        mask goes = mask_of(0);
        for (int l = 0; l < LANES; l++)
            LANE(goes, l) = i < steps_of(&a->lanes[l]) ? YES : 0;
        times_of(a, i, &t, &t_end, &h);
        for (int c = 0; c < N; c++) y[i][c] = now[c] = choose_row(goes, now[c], begin[c]);
        advance(t, t_end, h, now, a->own, shared, u, v, k[i]);
    }
    for (long i = longest - 1; i >= 0; i--) {
        for (int l = 0; l < LANES; l++)
            if (i < steps_of(&a->lanes[l])) add_outputs(a, l, step_at(&a->lanes[l], i));
        times_of(a, i, &t, &t_end, &h);
        retreat(t, t_end, h, y[i], (const row(*)[N])k[i], a->own, shared, w, x, a->back,
                a->of_varied);
    }
    for (int l = 0; l < LANES; l++) {
        Lane *lane = &a->lanes[l];
        if (lane->at >= 0) lane->behind = lane->part-- * BETWEEN;
    }
}

/* Motions that share all that is shared, from one on. */
static void pull_alike(const Call *call, const real *shared, long next, long end) {
    Lanes a;
    real u[NUMBERS + 1], w[BACK_NUMBERS + 1];
    row v[ROWS + 1], x[BACK_ROWS + 1];
    memset(&a, 0, sizeof a);
    a.call = call;
    prepare(shared, NULL, u, v);
    prepare_back(shared, NULL, w, x);
    for (int l = 0; l < LANES; l++) load(&a, l, next), a.lanes[l].at = -1;
    for (;;) {
        int some = 0;
        for (int l = 0; l < LANES; l++) {
            leave(&a, l);
            while (a.lanes[l].at < 0 && next < end) load(&a, l, next++), leave(&a, l);
            some |= a.lanes[l].at >= 0;
        }
        if (!some) return;
        pull_part(&a, shared, u, v, w, x);
    }
}

typedef struct {
    const Call *call;
    long block;
} Batch;

static void pull_block(void *job, long part) {
    const Batch *all = job;
    const long first = part * all->block, left = all->call->batch - first;
    const long end = first + (left < all->block ? left : all->block);
    for (long b = first, next; b < end; b = next) { /* of a batch of batches */
        next = behind_alike(all->call, SHARED_AT, b, end);
        pull_alike(all->call, member(all->call, SHARED_AT, b), b, next);
    }
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 1, 2, 2, 1, 1, 0, 0, 1, 2};
    Call call;
    if (!received(frame, axes, 1, &call)) return NULL;
    /* few blocks, whose lanes wait for the longest motion at their ends */
    const long fair = call.batch / (2 * processors()) + 1;
    Batch all = {&call, fair < 4 * LANES ? 4 * LANES : fair};
    in_parallel(pull_block, &all, (call.batch + all.block - 1) / all.block);
    return NULL;
}
