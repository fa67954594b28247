/* Cotangents of a motion's states, back along its steps, called from XLA; of a batch on
 * every processor. Before this text: along_steps.h, threads.h, and generated VARIED (numbers that are asked for, apart from the
 * state), BETWEEN (steps from one recorded state to the next), STAGES, NUMBERS and
 * BACK_NUMBERS (that prepare and prepare_back leave), and prepare, rates, prepare_back,
 * rates_back, advance, retreat.
 *
 * From a recorded state the steps to the next are taken again, and their rates kept.
 */

enum { SHARED_AT, KEPT_AT, COTANGENTS_AT, LAST_AT, WAY_AT };

static void pull(const Way *way, const real *shared, const real *kept, const real *cotangents,
                 real *back, real *of_varied) {
    real u[NUMBERS + 1], w[BACK_NUMBERS + 1], none[1];
    static _Thread_local real y[BETWEEN][N], k[BETWEEN][STAGES][N];
    long output = 0;
    prepare(shared, NULL, u, none);
    prepare_back(shared, NULL, w, none);
    memset(of_varied, 0, VARIED * sizeof(real));
    if (way->count) {
        const real end = step_of(way, way->count - 1).following;
        while (output + 1 < way->output_count && way->outputs[output + 1] <= end) output++;
    }
    const real s = way->sense;
    long behind = way->count;
    for (long part = (way->count + BETWEEN - 1) / BETWEEN - 1; part >= 0; part--) {
        const long first = part * BETWEEN;
        real now[N];
        memcpy(now, kept + part * N, sizeof now);
        for (long i = first; i < behind; i++) {
            const Step step = step_of(way, i);
            memcpy(y[i - first], now, sizeof now);
            advance(s * step.begin, s * step.end, s * (step.end - step.begin), now, shared,
                    u, k[i - first]);
        }
        for (long i = behind - 1; i >= first; i--) {
            const Step step = step_of(way, i);
            if (output && shows(way, step, output)) {
                for (int c = 0; c < N; c++) back[c] += cotangents[output * N + c];
                do output--; /* of outputs at one time the last alone has one */
                while (output && way->outputs[output] == way->outputs[output + 1]);
            }
            retreat(s * step.begin, s * step.end, s * (step.end - step.begin),
                    y[i - first], k[i - first], shared, w, back, of_varied);
        }
        behind = first;
    }
    /* that of an output that no step ended on leads nowhere known */
    for (long i = N; i < (output + 1) * N; i++)
        if (cotangents[i] != 0) {
            for (int c = 0; c < N; c++) back[c] = (real)NAN;
            for (int c = 0; c < VARIED; c++) of_varied[c] = (real)NAN;
        }
}

static void pull_member(void *job, long b) {
    const Call *call = job;
    const Way way = way_of(call, WAY_AT, b);
    real *back = wanted(call, 0, b), *of_varied = wanted(call, 1, b);
    memcpy(back, member(call, LAST_AT, b), N * sizeof(real));
    pull(&way, member(call, SHARED_AT, b), member(call, KEPT_AT, b),
         member(call, COTANGENTS_AT, b), back, of_varied);
}

void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1, 2, 2, 1, 1, 0, 0, 1, 2};
    Call call;
    if (!received(frame, axes, 1, &call)) return NULL;
    in_parallel(pull_member, &call, call.batch);
    return NULL;
}
