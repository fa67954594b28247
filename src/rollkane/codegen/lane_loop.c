/* Many motions in one loop over lanes. Before this text: lane_math.h, watch.h, and generated N
 * (numbers of a state), OWN (numbers of a model that differ), STAGES, ORDER, NUMBERS and ROWS
 * (that prepare leaves for rates), and prepare, rates, attempt; where WATCHED, the number of
 * vectors that no step may reverse, is not zero, also WATCH_NUMBERS and WATCH_ROWS,
 * prepare_watch and rates_watch; where ENDS, a whole program that is asked where a step may
 * end, ENDS_SMALL and given_at_end (step_ends.py).
 *
 * Every lane has a time and a step of its own. One that reaches a stop writes its output
 * and goes on; one that ends takes the next motion of the queue. The steps are those of
 * diffrax's explicit Runge-Kutta methods under its default controller. Time runs forwards
 * in the loop. With RECORD it is kept where steps began, and states of every BETWEEN steps.
 * With EVENTS steps end on them (event_search.c), and lanes may stop there.
 *
 * On a GPU (ON_DEVICE) a thread has one lane, and all take from one queue.
 */
enum { COMPLETED = 0, MAX_STEPS_REACHED, STEP_TOO_SMALL, BAD_START,
       STOPPED = 12, EVENT_NOT_FINITE }; /* Code */
#ifndef EVENTS
#define EVENTS 0
#endif
#ifndef ENDS
#define ENDS 0
#endif

typedef struct {
    long count, outputs, stops;
    const real *starts;      /* [count][N] */
    const real *own;         /* [count][OWN] */
    const real *shared;
    const real *atol;        /* [count][N] */
    const real *first_steps; /* [count] */
    const real *ends, *begins;
    const int64_t *slots;    /* [stops] */
    real time, rtol, dtmin, sense; /* 1, or -1 where time runs backwards */
    int64_t max_steps;
    const real *longest;     /* [count] steps; NULL: of any length */
#if ON_DEVICE
    Taken *taken;            /* how many of them are */
    const int32_t *order;    /* in which they are; NULL: their own */
#endif
} Queue;

/* final time, code, steps, rejected steps; of events, how often, and which ended the run */
enum { TOLD = 4 + (EVENTS ? EVENTS + 1 : 0) };

typedef struct {
    real *y;                 /* [count][outputs][N] */
    real *final_y;           /* [count][N] */
    real *told;              /* [count][TOLD] */
#if EVENTS
    real *moments;           /* [count][EVENT_CAPACITY][1 + N]: when, and states there */
#endif
#if RECORD
    real *record; /* [count][max_steps + 1]: where steps began, and the last one ended */
    real *kept;   /* [count][max_steps / BETWEEN + 1][N] */
#endif
} Results;

/* What is computed once for all motions that share their numbers. */
typedef struct {
    real u[NUMBERS + 1];
    row v[ROWS + 1];
#if WATCHED
    real watch_u[WATCH_NUMBERS + 1];
    row watch_v[WATCH_ROWS + 1];
#endif
#if EVENTS
    real event_u[EVENT_NUMBERS + 1];
    row event_v[EVENT_ROWS + 1];
#endif
} Prepared;

typedef struct {
    row t, t_end, wanted, longest, goal, y[N], k[N], atol[N], own[OWN ? OWN : 1];
    mask running, failed;
    int64_t steps[LANES], rejected[LANES];
    long motion[LANES], stop[LANES];
#if EVENTS
    row side[EVENTS], value[EVENTS]; /* signs that values had last; where the step begins */
    mask active, stopped, begun; /* where one is looked for, has ended the run; a new run */
    Search search[LANES];
#endif
} Lanes;

/* End of a step: the goal, or half the way to it where one step would fall short. On the
 * way to an only goal, like diffrax, the goal where the step would lead past it. */
INLINE row towards(int only, row goal, row t, row dt) {
    const row left = goal - t;
    if (only) return min_row(t + dt, goal);
    const row half = choose_row(dt > left * (real)0.5, left * (real)0.5, dt);
    return choose_row(dt >= left * (real)0.999, goal, t + half);
}

#if WATCHED
/* Where a step reverses none of the vectors, nor comes too near to their zeros to tell. */
INLINE mask unbroken(const Queue *q, const Prepared *p, const Lanes *a, const row *y) {
    const real *u = p->watch_u;
    const row *v = p->watch_v;
    row before[3 * WATCHED], after[3 * WATCHED];
    mask stands = mask_of(1);
    const real nearest = C(fmin)(NEAREST * q->rtol, (real)1 / CLOSEST);
    const row least = splat(nearest * nearest);
    rates_watch(q->sense * a->t, a->y, a->own, q->shared, NULL, u, v, before);
    rates_watch(q->sense * a->t_end, y, a->own, q->shared, NULL, u, v, after);
    for (int i = 0; i < 3 * WATCHED; i += 3)
        stands &= before[i] * after[i] + before[i + 1] * after[i + 1]
                + before[i + 2] * after[i + 2] > least;
    return stands;
}
#endif

#if ENDS
OF_THE_PROGRAM int to_end_now(void) { return told_to_end(); }

/* Which of the lanes' steps end where they may. */
static mask may_end(const Queue *q, const Lanes *a, const row *y, real *workspace) {
    mask may = mask_of(1);
    for (int l = 0; l < LANES; l++) {
        if (!LANE(a->running, l)) continue;
        real at[1 + N], small[ENDS_SMALL], told;
        at[0] = q->sense * LANE(a->t_end, l);
        for (int c = 0; c < N; c++) at[1 + c] = LANE(y[c], l);
        Frame frame = {.left[0] = &told, .workspace = workspace};
        given_at_end(&frame, small, at, q->shared, q->own + a->motion[l] * OWN);
        run(&frame);
        LANE(may, l) = told > 0 ? YES : 0;
    }
    return may;
}
#endif

#if EVENTS
/* Keep the events that a lane's step ends on. */
static void keep_events(const Queue *q, const Results *out, Lanes *a, int l, const row *y) {
    Search *s = &a->search[l];
    for (int e = 0; e < EVENTS; e++) {
        if (!s->fires[e]) continue;
        if (s->number[e] < event_most[e]) {
            const long place = a->motion[l] * EVENT_CAPACITY + event_first[e] + s->number[e];
            real *at = out->moments + place * (1 + N);
            at[0] = q->sense * LANE(a->t_end, l);
            for (int c = 0; c < N; c++) at[1 + c] = LANE(y[c], l);
        }
        s->number[e]++;
        if (event_ends[e] && !LANE(a->stopped, l)) s->by = e, LANE(a->stopped, l) = YES;
    }
}

/* Lanes of those that would stand whose step does not, as an event is behind it; trial
 * has the lengths of their next tries. */
static mask look_for_events(const Queue *q, const Results *out, Lanes *a, mask kept,
                            const row *y, const row *seen, row *trial) {
    mask some = a->active, looks = mask_of(0);
    for (int e = 0; e < EVENTS; e++) {
        const mask crossed = (a->side[e] != 0) & (sign_row(seen[e]) != a->side[e]);
        const mask moves = (a->value[e] != 0) | (seen[e] != 0); /* else it stays zero */
        some |= crossed & moves & (splat(event_way[e]) != a->side[e]);
    }
    some &= kept & a->running;
    a->active &= kept;
    for (int l = 0; any(some) && l < LANES; l++) {
        if (!LANE(some, l)) continue;
        real side[EVENTS], begin[EVENTS], values[EVENTS];
        int active = LANE(a->active, l) != 0;
        for (int e = 0; e < EVENTS; e++) {
            side[e] = LANE(a->side[e], l), begin[e] = LANE(a->value[e], l);
            values[e] = LANE(seen[e], l);
        }
        const real next = judged(&a->search[l], &active, side, begin, LANE(a->t, l),
                                 LANE(a->t_end, l), values);
        LANE(a->active, l) = active ? YES : 0;
        LANE(looks, l) = next > 0 ? YES : 0;
        LANE(*trial, l) = next;
        for (int e = 0; e < EVENTS; e++) LANE(a->side[e], l) = side[e];
        if (!(next > 0)) keep_events(q, out, a, l, y);
    }
    const mask stand = kept & not_row(looks);
    for (int e = 0; e < EVENTS; e++) {
        const mask signs = stand & not_row(some) & (seen[e] != 0);
        a->side[e] = choose_row(signs, sign_row(seen[e]), a->side[e]);
        a->value[e] = choose_row(stand & a->running, seen[e], a->value[e]);
    }
    return looks;
}

/* Where all events are numbers, at the ends of a step. */
INLINE mask events_known(const Lanes *a, const row *seen) {
    mask known = mask_of(1);
    for (int e = 0; e < EVENTS; e++)
        known &= (seen[e] == seen[e]) & (a->value[e] == a->value[e]);
    return known;
}
#endif

/* Record where a lane's next step begins. */
INLINE void note(const Queue *q, const Results *out, const Lanes *a, int l) {
#if RECORD
    const int64_t n = a->steps[l];
    const long i = a->motion[l];
    out->record[i * (q->max_steps + 1) + n] = q->sense * LANE(a->t, l);
    if (n % BETWEEN) return;
    real *kept = out->kept + (i * (q->max_steps / BETWEEN + 1) + n / BETWEEN) * N;
    for (int c = 0; c < N; c++) kept[c] = LANE(a->y[c], l);
#endif
}

/* Places that nothing may be written to. */
static void clear(const Queue *q, const Results *out, long i) {
    for (long c = 0; c < q->outputs * N; c++) out->y[i * q->outputs * N + c] = (real)NAN;
#if EVENTS
    const long room = EVENT_CAPACITY * (1 + N);
    for (long c = 0; c < room; c++) out->moments[i * room + c] = (real)NAN;
#endif
}

/* Write how a lane's motion ended. */
static void tell(const Queue *q, const Results *out, Lanes *a, int l) {
    const long i = a->motion[l];
    const int64_t tried = a->steps[l] + a->rejected[l];
    real *told = out->told + i * TOLD;
    int code = !LANE(a->failed, l)     ? COMPLETED
               : tried >= q->max_steps || told_to_end() ? MAX_STEPS_REACHED
               : a->steps[l] == 0      ? BAD_START
                                       : STEP_TOO_SMALL;
#if EVENTS
    if (code == COMPLETED && LANE(a->stopped, l)) code = STOPPED;
    if (code >= STEP_TOO_SMALL && code != STOPPED && a->search[l].by >= 0)
        code = EVENT_NOT_FINITE;
    for (int e = 0; e < EVENTS; e++) told[4 + e] = (real)a->search[l].number[e];
    told[4 + EVENTS] = (real)a->search[l].by;
    LANE(a->stopped, l) = LANE(a->active, l) = 0;
#endif
    told[0] = q->sense * LANE(a->t, l), told[1] = (real)code;
    told[2] = (real)a->steps[l], told[3] = (real)a->rejected[l];
    for (int c = 0; c < N; c++) out->final_y[i * N + c] = LANE(a->y[c], l);
}

/* Take the next motion into a lane; 0 where there is none. */
static int take(const Queue *q, const Results *out, Lanes *a, int l, long *ahead) {
#if ON_DEVICE
    *ahead = next_of(q->taken);
    const long next = *ahead < q->count ? (q->order ? q->order[*ahead] : *ahead) : -1;
#else
    const long next = *ahead < q->count ? (*ahead)++ : -1;
#endif
    LANE(a->failed, l) = 0, a->steps[l] = a->rejected[l] = 0, a->stop[l] = 0;
    a->motion[l] = next;
    if (next < 0) return 0;
    const real first = q->first_steps[next];
    const real longest = q->longest ? q->longest[next] : (real)INFINITY;
    LANE(a->t, l) = q->time;
    LANE(a->wanted, l) = first < longest ? first : longest;
    LANE(a->longest, l) = longest;
    for (int c = 0; c < N; c++) {
        LANE(a->y[c], l) = q->starts[next * N + c];
        LANE(a->atol[c], l) = q->atol[next * N + c];
    }
    for (int c = 0; c < OWN; c++) LANE(a->own[c], l) = q->own[next * OWN + c];
    clear(q, out, next);
    note(q, out, a, l);
#if EVENTS
    a->search[l] = no_search(q->time);
    LANE(a->begun, l) = YES;
#endif
    return 1;
}

/* Write what a lane has reached, and take the next motion where that is its end; 1 where
 * its rates have to be computed afresh. */
static int visit(const Queue *q, const Results *out, Lanes *a, int l, long *ahead) {
    const long i = a->motion[l];
    int fresh = 0, ended = i < 0 || LANE(a->failed, l);
#if EVENTS
    ended |= i >= 0 && LANE(a->stopped, l);
#endif
    if (i >= 0 && LANE(a->t, l) >= q->ends[a->stop[l]]) {
        const long stop = a->stop[l], slot = q->slots[stop];
        if (slot >= 0)
            for (int c = 0; c < N; c++)
                out->y[(i * q->outputs + slot) * N + c] = LANE(a->y[c], l);
        ended |= stop + 1 >= q->stops;
        if (!ended) {
            fresh = q->begins[stop] != LANE(a->t, l);
            LANE(a->t, l) = q->begins[stop];
            a->stop[l] = stop + 1;
            note(q, out, a, l);
        }
    }
    if (ended) {
        if (i >= 0) tell(q, out, a, l);
        if (!take(q, out, a, l, ahead)) return 0;
        fresh = 1;
    }
    LANE(a->running, l) = YES;
    LANE(a->goal, l) = q->ends[a->stop[l]];
    return fresh;
}

static void prepare_all(const real *shared, Prepared *p) {
    prepare(shared, NULL, p->u, p->v);
#if WATCHED
    prepare_watch(shared, NULL, p->watch_u, p->watch_v);
#endif
#if EVENTS
    prepare_events(shared, NULL, p->event_u, p->event_v);
#endif
}

/* Integrate a queue of motions to its end; returns the steps of the whole row. */
static int64_t run_lanes(const Queue *q, const Prepared *p, const Results *out) {
    Lanes a;
    row k[STAGES][N], y[N], error[N], first[N];
#if EVENTS
    row seen[EVENTS];
#endif
#if ENDS
    real *workspace = malloc((WORKSPACE + 1) * sizeof *workspace);
#endif
    long ahead = 0;
    int64_t turns = 0;
    memset(&a, 0, sizeof a);
    for (int l = 0; l < LANES; l++) a.motion[l] = -1;
    const int only = q->stops == 1 && !EVENTS;
    for (;;) {
        mask fresh = mask_of(0), moved = mask_of(0);
        for (int l = 0; l < LANES; l++) {
            if (LANE(a.running, l) || (a.motion[l] < 0 && ahead >= q->count)) continue;
            LANE(moved, l) = YES;
            LANE(fresh, l) = visit(q, out, &a, l, &ahead) ? YES : 0;
        }
        if (!any(a.running)) break;
        a.t_end = choose_row(moved, towards(only, a.goal, a.t, a.wanted), a.t_end);
        if (any(fresh)) {
#if EVENTS
            rates_events(q->sense * a.t, a.y, a.own, q->shared, NULL, p->event_u, p->event_v,
                         first, seen);
            for (int e = 0; e < EVENTS; e++) {
                a.value[e] = choose_row(a.begun, seen[e], a.value[e]);
                a.side[e] = choose_row(a.begun, sign_row(seen[e]), a.side[e]);
            }
            a.begun = mask_of(0);
#else
            rates(q->sense * a.t, a.y, a.own, q->shared, NULL, p->u, p->v, first);
#endif
            for (int c = 0; c < N; c++) a.k[c] = choose_row(fresh, first[c], a.k[c]);
        }
        mask paused;
        do {
            const row h = a.t_end - a.t, way = h * q->sense;
            memcpy(k[0], a.k, sizeof a.k);
#if EVENTS
            attempt(a.t * q->sense, a.t_end * q->sense, way, a.y, q->shared, a.own, p->u,
                    p->v, k, y, error, p->event_u, p->event_v, seen);
#else
            attempt(a.t * q->sense, a.t_end * q->sense, way, a.y, q->shared, a.own, p->u,
                    p->v, k, y, error);
#endif
            row size = splat(0);
            for (int c = 0; c < N; c++) {
                const row most = max_row(abs_row(a.y[c]), abs_row(y[c]));
                const row e = error[c] / fma_row(most, splat(q->rtol), a.atol[c]);
                size = fma_row(e, e, size);
            }
            /* what is below the numbers' own rounding is noise, another on every machine */
            size = max_row(sqrt_row(size / (real)N) - EPSILON / q->rtol, splat(0));
            size = choose_row(size < (real)1e12, size, splat((real)1e12)); /* NaN too */
#if WATCHED
            size = choose_row(unbroken(q, p, &a, y), size, splat((real)1e12));
#endif
#if ENDS
            size = choose_row(may_end(q, &a, y, workspace), size, splat((real)1e12));
#endif
#if EVENTS
            const mask known = events_known(&a, seen);
            size = choose_row(known, size, splat((real)1e12));
            row trial = splat(0);
            const mask good = size < 1;
            const mask looks = look_for_events(q, out, &a, good, y, seen, &trial);
            const mask kept = good & not_row(looks);
#else
            const mask kept = size < 1;
#endif
            row factor = root(max_row(size, splat((real)1e-12))) * (real)0.9;
            const row least = choose_row(kept, splat(1), splat((real)0.2));
            const row most = choose_row(kept, splat(10), splat((real)0.9));
            factor = min_row(max_row(factor, least), most);
            row dt = min_row(h * factor, a.longest);
#if EVENTS /* a step that ends on one may be as short as it has to be */
            mask small = not_row(good) & (h * (real)0.2 < q->dtmin);
            for (int e = 0; e < EVENTS; e++) small |= a.value[e] != a.value[e];
#else
            const mask small = dt < q->dtmin;
#endif
            const mask shortened = kept & (h < a.wanted * (real)0.999);
            dt = choose_row(shortened, max_row(dt, a.wanted), dt);
            const mask go = kept & a.running, refused = not_row(kept) & a.running;
            mask landed = go & (a.t_end >= a.goal);
            a.t = choose_row(go, a.t_end, a.t);
            for (int c = 0; c < N; c++) {
                a.y[c] = choose_row(go, y[c], a.y[c]);
                a.k[c] = choose_row(go, k[STAGES - 1][c], a.k[c]);
            }
            mask out_of_steps = mask_of(0);
            const int heard = turns % 64 == 0; /* microseconds apart, and for nothing */
            const int over = heard && told_to_end();
#if ONE_LANE
            if (heard) tell_time((double)(q->sense * a.t));
#endif
            for (int l = 0; l < LANES; l++) {
                a.steps[l] += LANE(go, l) != 0, a.rejected[l] += LANE(refused, l) != 0;
                const int spent = a.steps[l] + a.rejected[l] >= q->max_steps || over;
                const int arrived = LANE(landed, l) && a.stop[l] + 1 >= q->stops;
                LANE(out_of_steps, l) = spent && !arrived ? YES : 0;
                if (LANE(go, l)) note(q, out, &a, l);
            }
#if EVENTS
            dt = choose_row(looks, a.wanted, dt);
#endif
            a.wanted = choose_row(a.running, dt, a.wanted);
            a.t_end = choose_row(a.running, towards(only, a.goal, a.t, dt), a.t_end);
#if EVENTS
            a.t_end = choose_row(a.running & looks, min_row(a.t + trial, a.goal), a.t_end);
            const mask lost = a.running & small & not_row(known);
            for (int l = 0; any(lost) && l < LANES; l++) {
                if (!LANE(lost, l)) continue;
                for (int e = EVENTS - 1; e >= 0; e--)
                    if (isnan(LANE(seen[e], l)) || isnan(LANE(a.value[e], l)))
                        a.search[l].by = e;
            }
            landed |= a.running & a.stopped;
            out_of_steps &= not_row(a.stopped);
#endif
            a.failed |= a.running & (small | out_of_steps);
            paused = a.running & (landed | a.failed);
            a.running &= not_row(paused);
            turns++;
            /* a thread that pauses must not wait for the others of its warp */
        } while (!ON_DEVICE && !any(paused));
    }
#if ENDS
    free(workspace);
#endif
    return turns;
}

int64_t integrate(const Queue *q, const Results *out) {
    Prepared p;
    prepare_all(q->shared, &p);
    return run_lanes(q, &p, out);
}
