/* Memory of who waits for a run and may look at it; NULL before it is known (run_watch.py). */
typedef struct {
    double time;             /* how far a motion has come [s], while it is looked at */
    int32_t looks, ends;     /* whether somebody looks; whether runs are to end now */
} Watch;
Watch *rollkane_watch;

/* Tell who looks how far a motion has come [s]. */
INLINE void tell_time(double time) {
    if (rollkane_watch && rollkane_watch->looks) rollkane_watch->time = time;
}

/* Whether runs are to end where they are. */
INLINE int told_to_end(void) {
    return rollkane_watch && *(volatile int32_t *)&rollkane_watch->ends;
}
