/* Writes as fast as it can, or reads and looks whether each value is whole: for the tests.
 *
 * hammer write SEGMENT PAUSE_US       for ever
 * hammer read SEGMENT SECONDS LAST    until the value LAST, or so long; prints what it met
 */
#include "states.h"

enum { LENGTH = sizeof(((struct unicon_measured *)0)->numbers) / sizeof(double) };

static int do_write(const char *name, long pause_us)
{
    struct unicon_segment segment;
    struct unicon_measured value;
    struct timespec pause = {0, pause_us * 1000};
    int64_t i;
    int k;
    if (unicon_create(&segment, name, UNICON_ALL) != 0) {
        fprintf(stderr, "%s\n", segment.problem);
        return 1;
    }
    memset(&value, 0, sizeof value);
    for (i = 1;; i++) {
        for (k = 0; k < LENGTH; k++)
            value.numbers[k] = (double)i;
        value.count = i;
        unicon_publish_measured(&segment, &value);
        if (pause_us > 0)
            nanosleep(&pause, NULL);
    }
}

static int do_read(const char *name, double seconds, int64_t last)
{
    struct unicon_reader reader;
    struct unicon_measured value;
    const int64_t end = unicon_now_ns() + (int64_t)(seconds * 1e9);
    long taken = 0, torn = 0, back = 0;
    int64_t before = 0;
    int k;
    if (unicon_attach_measured(&reader, name) != 0) {
        fprintf(stderr, "%s\n", reader.segment.problem);
        return 1;
    }
    while (before != last && unicon_now_ns() < end) {
        int whole = 1, there = unicon_wait(&reader, 0.02);
        if (there < 0) {
            fprintf(stderr, "%s\n", reader.segment.problem);
            unicon_detach(&reader);
            return 1;
        }
        if (there == 0 || unicon_take_measured(&reader, &value) != 1)
            continue;
        for (k = 0; k < LENGTH; k++)
            whole = whole && value.numbers[k] == (double)value.count;
        taken++;
        torn += !whole || value.count != (int64_t)reader.number;
        back += value.count <= before;
        before = value.count;
    }
    printf("%ld %ld %ld %llu %lld\n", taken, torn, back, (unsigned long long)reader.starved,
           (long long)before);
    unicon_detach(&reader);
    return 0;
}

int main(int argc, char **argv)
{
    if (argc == 4 && strcmp(argv[1], "write") == 0)
        return do_write(argv[2], strtol(argv[3], NULL, 10));
    if (argc == 5 && strcmp(argv[1], "read") == 0)
        return do_read(argv[2], strtod(argv[3], NULL), strtoll(argv[4], NULL, 10));
    return 2;
}
