/* Handlers that XLA may know before their programs are compiled: a call waits for its own.
 * Before this text: xla_call.h, SLOTS of them and ENTRIES, each with a function. */

#include <errno.h>
#include <pthread.h>
#include <string.h>
#include <time.h>

enum { PATIENCE = 900, LONGEST = 1000 }; /* of a call [s]; of what is told [characters] */

typedef void *Handler(const CallFrame *frame);
static struct {
    Handler *handler; /* NULL until it is there */
    char failed[LONGEST];
} slots[SLOTS];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed = PTHREAD_COND_INITIALIZER;

static void *refused(const CallFrame *frame, const char *why) {
    ErrorAsked asked = {sizeof asked, NULL, why, INTERNAL};
    return frame->api->error_create(&asked);
}

static void *called(int i, const CallFrame *frame) {
    Handler *handler = __atomic_load_n(&slots[i].handler, __ATOMIC_ACQUIRE);
    if (handler) return handler(frame);
    if (told_version(frame)) return NULL;
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec += PATIENCE;
    int waited = 0;
    pthread_mutex_lock(&lock);
    while (!slots[i].handler && !slots[i].failed[0] && waited != ETIMEDOUT)
        waited = pthread_cond_timedwait(&changed, &lock, &until);
    handler = slots[i].handler;
    pthread_mutex_unlock(&lock);
    if (handler) return handler(frame);
    return refused(frame, slots[i].failed[0] ? slots[i].failed : "the C compiler hangs");
}

#define ENTRY(i) \
    static void *entry##i(const CallFrame *frame) { return called(i, frame); }
ENTRIES
#undef ENTRY

/* What XLA is to call for a slot. */
void *entry_of(int i) {
#define ENTRY(i) entry##i,
    static Handler *const entries[] = {ENTRIES};
    return (void *)entries[i];
}

/* Its program, or why there is none; neither: it is coming. */
void settle(int i, void *handler, const char *failed) {
    pthread_mutex_lock(&lock);
    strncpy(slots[i].failed, failed, LONGEST - 1);
    __atomic_store_n(&slots[i].handler, (Handler *)handler, __ATOMIC_RELEASE);
    pthread_cond_broadcast(&changed);
    pthread_mutex_unlock(&lock);
}
