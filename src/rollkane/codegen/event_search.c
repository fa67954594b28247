/* Search for steps that end on events: by inverse interpolation within a bracket, as
 * integration/event_search.py has it. Before this text: lane_math.h, and generated EVENTS (how
 * many), EVENT_CAPACITY (places of all that are kept), EVENT_CLOSE, EVENT_START, EVENT_FLAT,
 * EVENT_HALVES, EVENT_TRIES (see event_layout.py), event_way, event_ends, event_most,
 * event_first (of each), and prepare_events and rates_events, which gives the rates and
 * their values.
 */

typedef struct {
    real zero[EVENTS], mean[EVENTS];    /* times of the last zeros; rates over the whole step */
    real low, high, whole;              /* lengths of the step */
    real length[EVENT_TRIES];           /* the last tries, newest first; its begin is the oldest */
    real seen[EVENT_TRIES][EVENTS];     /* values there */
    int due[EVENTS], fires[EVENTS];
    int64_t tries, number[EVENTS];
    int by;                             /* which one ended the run; -1: none */
} Search;

static Search no_search(real t) {
    Search s;
    memset(&s, 0, sizeof s);
    for (int e = 0; e < EVENTS; e++) s.zero[e] = t;
    s.by = -1;
    return s;
}

/* Length at which event e is zero: the polynomial of the length in terms of the value
 * through the last tries (Neville), of the order to which its corrections halve. */
static real zero_between(const Search *s, int e) {
    real through[EVENT_TRIES], change = (real)1e30;
    const int64_t known = s->tries + 1 < EVENT_TRIES ? s->tries + 1 : EVENT_TRIES;
    real found = s->length[0];
    for (int m = 0; m < known; m++) {
        through[m] = s->length[m];
        for (int j = m - 1; j >= 0; j--)
            through[j] -= s->seen[j][e] * (through[j + 1] - through[j]) /
                          (s->seen[m][e] - s->seen[j][e]);
        const real moved = C(fabs)(through[0] - found);
        if (m > 0 && !(moved < (real)0.5 * change)) break; /* NaN too */
        if (m > 0) change = moved;
        found = through[0];
    }
    return found;
}

/* Length of the next try: where the first of the events has its zero. */
static real next_try(const Search *s, int jumps, const real *side, const real *begin,
                     const int *flat, real tiny) {
    const real low = s->low, high = s->high, middle = (real)0.5 * (low + high);
    if (high - low <= tiny) return high; /* the step ends behind the zero */
    if ((s->tries > EVENT_HALVES && s->tries % 2 == 0) || high - low <= 2 * tiny)
        return middle;
    real trial = high;
    for (int e = 0; e < EVENTS; e++) {
        if (!s->due[e]) continue;
        real root = flat[e] ? middle : zero_between(s, e);
        if (!(root >= low && root <= high)) root = middle;
        if (jumps && begin[e] * side[e] <= 0) root = 0;
        if (root < trial) trial = root;
    }
    return trial < low + tiny ? low + tiny : trial > high - tiny ? high - tiny : trial;
}

/* Judge a step from t0 to t1 that would stand, on the way to an event or with one behind
 * it; fires tells which it ends on. Begin: values where it begins. Gives 0 where the step
 * stands, else the length of the next try; a search goes on where active is left. */
static real judged(Search *s, int *active, real *side, const real *begin, real t0, real t1,
                   const real *values) {
    const real x = t1 - t0;
    const int begins = !*active;
    const real apart_before = begins ? x : s->high - s->low;
    int crossed[EVENTS], near[EVENTS], flat[EVENTS], hits = 0;
    if (begins) {
        s->low = 0, s->high = x, s->length[0] = 0, s->whole = x, s->tries = 0;
        memcpy(s->seen[0], begin, sizeof s->seen[0]);
        for (int e = 0; e < EVENTS; e++) s->mean[e] = C(fabs)(values[e] - begin[e]) / x;
    }
    for (int e = 0; e < EVENTS; e++) {
        /* a value that reaches zero has crossed it, and may stay there; a search for where
         * it left zero again goes back through zeros to the step's begin */
        const int rests = begin[e] == 0 && values[e] == 0 && (begins || !s->due[e]);
        crossed[e] = side[e] != 0 && sign_one(values[e]) != side[e] &&
                     event_way[e] != side[e] && !rests;
        hits |= crossed[e];
    }
    if (begins || hits) memcpy(s->due, crossed, sizeof crossed);
    if (hits) s->high = x;
    else s->low = x;
    const real tiny = EVENT_CLOSE * EPSILON * (C(fabs)(t0) + s->whole), apart = x - s->length[0];
    int all = 1, one = 0;
    for (int e = 0; e < EVENTS; e++) {
        const real rise = values[e] - s->seen[0][e];
        flat[e] = rise == 0 || apart == 0 || !(rise - rise == 0);
        const real off = values[e] * apart / (flat[e] ? 1 : rise);
        const int known =
            !flat[e] && EVENT_FLAT * C(fabs)(rise) >= s->mean[e] * C(fabs)(apart);
        /* a value that is zero may have been so before */
        near[e] = known && C(fabs)(off) <= tiny && values[e] != 0;
        all &= near[e] || !crossed[e];
        one |= near[e] && s->due[e];
    }
    /* a closed bracket's end behind the zero is tried again, once: it may be rounded */
    const int shut = s->high - s->low <= tiny && (hits || (!begins && apart_before <= tiny));
    const int done = shut || (hits ? all : one && !(s->high - s->low <= tiny));
    for (int j = EVENT_TRIES - 1; j > 0; j--) {
        s->length[j] = s->length[j - 1];
        memcpy(s->seen[j], s->seen[j - 1], sizeof s->seen[j]);
    }
    memcpy(s->seen[0], values, sizeof s->seen[0]);
    s->length[0] = x, s->tries++;
    *active = !done;
    if (!done) return next_try(s, begins, side, begin, flat, tiny);
    const real least = EVENT_START * EPSILON * s->whole;
    const real own = least > 4 * tiny ? least : 4 * tiny;
    int found[EVENTS];
    for (int e = 0; e < EVENTS; e++) {
        found[e] = (hits && crossed[e]) || (s->due[e] && (near[e] || shut));
        /* a zero right behind the one before, or the start, is that one */
        s->fires[e] = found[e] && !(t1 - (begin[e] == 0 ? t0 : s->zero[e]) <= own);
    }
    for (int e = 0; e < EVENTS; e++) {
        if (found[e]) side[e] = -side[e];
        else if (values[e] != 0) side[e] = sign_one(values[e]);
        if (s->fires[e]) s->zero[e] = t1;
    }
    return 0;
}
