/* Words of rollkane's device.h for a processor: one thread after the other. */
#define ON_DEVICE 1
#define LOCAL static
/* the driver hands on where the arguments are */
#define KERNEL(name)                                                                   \
    static void name##_of(Sent sent);                                                  \
    void name(const Sent *sent) { name##_of(*sent); }                                  \
    static void name##_of(Sent sent)
#define OF_BLOCK static
#define FIRST_OF_BLOCK (emulated.thread % emulated.block == 0)
#define TOGETHER() (void)0
#define THREAD (emulated.thread)
#define THREADS (emulated.threads)
#define BATCH_ROW (emulated.row)
#define BATCH_ROWS (emulated.rows)
#define told_to_end() 0
#define tell_time(time) (void)(time)

struct Emulated {
    long thread, threads, block, row, rows;
} emulated;
typedef unsigned long long Taken;
static inline long next_of(Taken *taken) { return (long)(*taken)++; }
