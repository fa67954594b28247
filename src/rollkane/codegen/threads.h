/* Work that is split among the processors at hand. */
#ifdef _WIN32
static long processors(void) { return 1; }
static void in_parallel(void (*work)(void *, long), void *job, long parts) {
    for (long i = 0; i < parts; i++) work(job, i);
}
#else
#include <pthread.h>
#include <unistd.h>
#ifdef __linux__
#include <sched.h>
#endif

/* Those that this process may use. */
static long processors(void) {
#if defined(__linux__) && defined(CPU_COUNT)
    cpu_set_t set;
    if (!sched_getaffinity(0, sizeof set, &set)) return CPU_COUNT(&set);
#endif
    const long count = sysconf(_SC_NPROCESSORS_ONLN);
    return count > 0 ? count : 1;
}

typedef struct {
    void (*work)(void *, long);
    void *job;
    long parts, next;
} Shared;

static void *take_parts(void *given) {
    Shared *s = given;
    for (;;) {
        const long i = __atomic_fetch_add(&s->next, 1, __ATOMIC_RELAXED);
        if (i >= s->parts) return NULL;
        s->work(s->job, i);
    }
}

/* work(job, i) for all i below parts, each by whoever is free; returns when all are done. */
static void in_parallel(void (*work)(void *, long), void *job, long parts) {
    enum { MOST = 255 };
    pthread_t others[MOST];
    Shared s = {work, job, parts, 0};
    long wanted = processors() - 1, started = 0;
    if (wanted > parts - 1) wanted = parts - 1;
    if (wanted > MOST) wanted = MOST;
    while (started < wanted && !pthread_create(&others[started], NULL, take_parts, &s))
        started++;
    take_parts(&s);
    while (started > 0) pthread_join(others[--started], NULL);
}
#endif
