/* The part of a header by `unicon states --header` that is the same for all: one process publishes
 * groups of states into shared memory, others take the newest whole value. C99 or C++11, gcc or
 * clang, Linux, 64 bits. docs/states.md tells the format and why the order of memory is kept. */

#ifndef _GNU_SOURCE
#define _GNU_SOURCE 1 /* O_TMPFILE, F_OFD_SETLK, syscall */
#endif
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#if !defined(F_OFD_SETLK) || !defined(O_TMPFILE)
#error "include this header before all others, or compile with -D_GNU_SOURCE"
#endif
#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__ || __SIZEOF_POINTER__ != 8
#error "segments of unicon are for little-endian machines of 64 bits"
#endif

#if defined(__cplusplus)
#define UNICON_ASSERT(fact) static_assert(fact, #fact)
#elif __STDC_VERSION__ >= 201112L
#define UNICON_ASSERT(fact) _Static_assert(fact, #fact)
#else
#define UNICON_ASSERT_IN(fact, line) typedef char unicon_assert_##line[(fact) ? 1 : -1]
#define UNICON_ASSERT_AT(fact, line) UNICON_ASSERT_IN(fact, line)
#define UNICON_ASSERT(fact) UNICON_ASSERT_AT(fact, __LINE__) __attribute__((unused))
#endif
#define UNICON_PLACE(type, field, offset, size) \
    UNICON_ASSERT(offsetof(type, field) == offset && sizeof(((type *)0)->field) == size)

#define UNICON_FOLDER "/dev/shm"
#define UNICON_PLACES ((int64_t)1 << 32) /* here the bytes begin that readers lock who sleep */

enum {
    UNICON_VERSION = 1,
    UNICON_JSON_AT = 128, /* behind struct unicon_head */
    UNICON_SLOTS = 4,
    UNICON_SLEEPERS = 64, /* of a group: one byte for each reader that sleeps */
    UNICON_MAX_SLEEPERS = 64,
    UNICON_RING = 128,    /* of a group: the slots */
    UNICON_BYTES = 64,    /* of a slot: the value, behind number and stamp */
    UNICON_TRIES = 1000
};

struct unicon_head {
    char magic[8];
    uint32_t version, byte_order;
    int64_t pid;
    uint64_t started, size, json_length;
    char hash[64];
};
UNICON_ASSERT(sizeof(struct unicon_head) == 112);

/* One choice of groups that a segment can hold. */
struct unicon_form {
    const char *json, *hash;
    uint64_t json_length, size;
    uint64_t starts[UNICON_GROUPS]; /* 0: the group is not in it */
};

struct unicon_segment {
    unsigned char *memory; /* NULL: closed */
    uint64_t size;
    const struct unicon_form *form;
    ino_t inode;
    int fd;
    pid_t owner;      /* the process that removes it in the end, 0: another one */
    uint64_t in_vain; /* wakes that nobody heard */
    char path[160];
    char problem[400]; /* after a function that returned -1: why, in one line */
};

struct unicon_reader {
    struct unicon_segment segment;
    const struct unicon_form *forms; /* that it accepts */
    int num_forms, group, place;     /* place: among those that sleep, -1: none */
    uint64_t nbytes;
    uint64_t number;   /* of the value taken last, counted by its writer from 1 */
    uint64_t skipped;  /* values between those taken */
    uint64_t starved;  /* takes that met no whole value in a thousand looks */
    int64_t stamp_ns;  /* when it was published, of CLOCK_MONOTONIC */
    unsigned char *scratch;
};

static inline int unicon_fail(struct unicon_segment *segment, const char *what, int code)
{
    snprintf(segment->problem, sizeof segment->problem, "%s: %s%s%s", segment->path, what,
             code ? ": " : "", code ? strerror(code) : "");
    return -1;
}

static inline int64_t unicon_now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* Lock one byte for this open file, not for the process (F_WRLCK), or let it go (F_UNLCK); false
 * where another open file has it. */
static inline int unicon_lock(int fd, int type, int64_t at)
{
    struct flock wish;
    memset(&wish, 0, sizeof wish);
    wish.l_type = (short)type;
    wish.l_whence = SEEK_SET;
    wish.l_start = at;
    wish.l_len = 1;
    return fcntl(fd, F_OFD_SETLK, &wish) == 0;
}

static inline int unicon_writer_lives(int fd)
{
    struct flock wish;
    memset(&wish, 0, sizeof wish);
    wish.l_type = F_RDLCK;
    wish.l_whence = SEEK_SET;
    wish.l_len = 1;
    return fcntl(fd, F_OFD_GETLK, &wish) == 0 && wish.l_type != F_UNLCK;
}

static inline int unicon_begin(struct unicon_segment *segment, const char *name)
{
    size_t length = strlen(name);
    memset(segment, 0, sizeof *segment);
    segment->fd = -1;
    snprintf(segment->path, sizeof segment->path, "%s/unicon-%lu-%.100s", UNICON_FOLDER,
             (unsigned long)getuid(), name);
    if (length < 1 || length > 100
        || strspn(name, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_.-")
               != length)
        return unicon_fail(segment, "a segment cannot be named so; use letters, digits, _ . -", 0);
    return 0;
}

static inline int unicon_replaced(const struct unicon_segment *segment)
{
    struct stat status;
    return stat(segment->path, &status) == 0 && status.st_ino != segment->inode;
}

/* Let a segment go; its writer removes it. Safe to call twice, and in a child of a fork, which
 * should: a forked child that has it would keep the writer's lock after the writer has died. */
static inline void unicon_close(struct unicon_segment *segment)
{
    if (segment->memory != NULL) {
        if (segment->owner == getpid()) {
            if (!unicon_replaced(segment))
                unlink(segment->path);
            unicon_lock(segment->fd, F_UNLCK, 0); /* a forked child may have it, too */
        }
        munmap(segment->memory, segment->size);
    }
    if (segment->fd >= 0)
        close(segment->fd);
    segment->memory = NULL;
    segment->fd = -1;
}

/* Remove what a dead writer left: 1 it has gone, 0 its writer lives, -1 it cannot be. */
static inline int unicon_remove_dead(const char *path)
{
    struct timespec nap = {0, 1000000};
    struct stat named, found;
    char magic[8];
    int tries, dead = 0, fd = open(path, O_RDWR | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0)
        return errno == ENOENT ? 1 : -1;
    if (fstat(fd, &found) != 0 || found.st_uid != getuid()
        || pread(fd, magic, sizeof magic, 0) != (ssize_t)sizeof magic
        || memcmp(magic, "UNICONSH", sizeof magic) != 0) {
        close(fd);
        errno = EPERM;
        return -1;
    }
    /* Somebody else who removes it has the lock for a moment, too. */
    for (tries = 0; tries < 20 && !dead; tries++) {
        if (tries > 0)
            nanosleep(&nap, NULL);
        dead = unicon_lock(fd, F_WRLCK, 0);
    }
    if (dead && stat(path, &named) == 0 && named.st_ino == found.st_ino)
        unlink(path);
    close(fd);
    return dead;
}

/* When this process started, in clock ticks since boot: field 22 of proc(5). */
static inline uint64_t unicon_started(void)
{
    char text[1024], *at;
    unsigned long long started = 0;
    int field;
    FILE *file = fopen("/proc/self/stat", "re");
    size_t length = file != NULL ? fread(text, 1, sizeof text - 1, file) : 0;
    if (file != NULL)
        fclose(file);
    text[length] = '\0';
    at = strrchr(text, ')'); /* the end of field 2, a name which may hold anything */
    for (field = 2; at != NULL && field < 22; field++)
        at = strchr(at + 1, ' ');
    if (at != NULL)
        started = strtoull(at + 1, NULL, 10);
    return (uint64_t)started;
}

static inline int unicon_name(struct unicon_segment *segment)
{
    char nameless[64];
    int tries, removed;
    snprintf(nameless, sizeof nameless, "/proc/self/fd/%d", segment->fd);
    for (tries = 0; tries < UNICON_TRIES; tries++) {
        if (linkat(AT_FDCWD, nameless, AT_FDCWD, segment->path, AT_SYMLINK_FOLLOW) == 0)
            return 0;
        if (errno != EEXIST)
            return unicon_fail(segment, "cannot be named", errno);
        removed = unicon_remove_dead(segment->path);
        if (removed < 0)
            return unicon_fail(segment, "is not what a writer of yours left; remove it", errno);
        if (removed == 0)
            return unicon_fail(segment, "another process writes it just now; end that one", 0);
    }
    return unicon_fail(segment, "others make it all the time; use another name", 0);
}

/* Make a segment; what a writer that died has left is replaced. 0, or -1 and `problem`. */
static inline int unicon_create(struct unicon_segment *segment, const char *name,
                                const struct unicon_form *form)
{
    struct unicon_head head = {{'U', 'N', 'I', 'C', 'O', 'N', 'S', 'H'}, UNICON_VERSION, 0x01020304,
                               0, 0, 0, 0, {0}};
    struct stat status;
    void *memory;
    int code;
    if (unicon_begin(segment, name) != 0)
        return -1;
    /* Without a name until all of it is there: nobody ever reads half a header. */
    segment->fd = open(UNICON_FOLDER, O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    if (segment->fd < 0)
        return unicon_fail(segment, "cannot be made", errno);
    code = posix_fallocate(segment->fd, 0, (off_t)form->size); /* no room: now, not SIGBUS later */
    memory = code ? MAP_FAILED : mmap(NULL, form->size, PROT_READ | PROT_WRITE, MAP_SHARED,
                                      segment->fd, 0);
    if (memory == MAP_FAILED) {
        unicon_fail(segment, "no room; make some in " UNICON_FOLDER, code ? code : errno);
        unicon_close(segment);
        return -1;
    }
    segment->memory = (unsigned char *)memory;
    segment->size = form->size;
    segment->form = form;
    head.pid = getpid();
    head.started = unicon_started();
    head.size = form->size;
    head.json_length = form->json_length;
    memcpy(head.hash, form->hash, sizeof head.hash);
    memcpy(segment->memory, &head, sizeof head);
    memcpy(segment->memory + UNICON_JSON_AT, form->json, form->json_length);
    if (fstat(segment->fd, &status) != 0 || !unicon_lock(segment->fd, F_WRLCK, 0)) {
        unicon_fail(segment, "cannot be locked", errno);
        unicon_close(segment);
        return -1;
    }
    segment->inode = status.st_ino;
    if (unicon_name(segment) != 0) {
        unicon_close(segment);
        return -1;
    }
    segment->owner = getpid();
    return 0;
}

/* Map the segment of a name, after every field of its header is found right. */
static inline int unicon_map(struct unicon_segment *segment, const char *name,
                             const struct unicon_form *forms, int num_forms)
{
    struct unicon_head head;
    struct stat status;
    void *memory = MAP_FAILED;
    const char *wrong = NULL;
    int i;
    memset(&head, 0, sizeof head);
    if (unicon_begin(segment, name) != 0)
        return -1;
    segment->fd = open(segment->path, O_RDWR | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
    if (segment->fd < 0 || fstat(segment->fd, &status) != 0) {
        unicon_fail(segment, "cannot be read; is its writer running?", errno);
        unicon_close(segment);
        return -1;
    }
    if (status.st_uid != getuid())
        wrong = "belongs to another user; remove it";
    else if (!S_ISREG(status.st_mode) || status.st_size < UNICON_JSON_AT)
        wrong = "is not a segment; remove it";
    else
        memory = mmap(NULL, (size_t)status.st_size, PROT_READ | PROT_WRITE, MAP_SHARED,
                      segment->fd, 0);
    if (wrong == NULL && memory == MAP_FAILED)
        wrong = "cannot be mapped";
    if (wrong == NULL) {
        segment->memory = (unsigned char *)memory;
        segment->size = (uint64_t)status.st_size;
        segment->inode = status.st_ino;
        memcpy(&head, memory, sizeof head);
        if (memcmp(head.magic, "UNICONSH", sizeof head.magic) != 0)
            wrong = "is not a segment of unicon; remove it";
        else if (head.byte_order != 0x01020304)
            wrong = "has another byte order";
        else if (head.version != UNICON_VERSION)
            wrong = "is of another version; make this header with the unicon that writes it";
        else if (head.size != segment->size || head.json_length > head.size - UNICON_JSON_AT)
            wrong = "is not as long as it says; remove it";
    }
    for (i = 0; wrong == NULL && i < num_forms && segment->form == NULL; i++)
        if (memcmp(head.hash, forms[i].hash, sizeof head.hash) == 0
            && head.size == forms[i].size && head.json_length == forms[i].json_length
            && memcmp(segment->memory + UNICON_JSON_AT, forms[i].json, head.json_length) == 0)
            segment->form = &forms[i];
    if (wrong == NULL && segment->form == NULL)
        wrong = "has other states than this program; make its header anew: unicon states --header";
    if (wrong != NULL) {
        unicon_fail(segment, wrong, 0);
        unicon_close(segment);
        return -1;
    }
    return 0;
}

/* Take the places of readers that were killed asleep back, for whom each publishing would wake. */
static inline void unicon_clear_dead(struct unicon_segment *segment, unsigned char *flags)
{
    int place;
    for (place = 0; place < UNICON_MAX_SLEEPERS; place++)
        if (flags[place] != 0 && unicon_lock(segment->fd, F_WRLCK, UNICON_PLACES + place)) {
            flags[place] = 0;
            unicon_lock(segment->fd, F_UNLCK, UNICON_PLACES + place);
        }
}

/* Publish a value; nobody who reads can make it wait. 0, or -1: the group is not in the segment. */
static inline int unicon_publish(struct unicon_segment *segment, int group, const void *value,
                                 uint64_t nbytes)
{
    unsigned char *ring, *slot;
    uint64_t *latest, *sleepers, number, asleep = 0;
    int i;
    if (segment->memory == NULL || segment->form->starts[group] == 0)
        return unicon_fail(segment, "is closed, or has no such group", 0);
    ring = segment->memory + segment->form->starts[group];
    latest = (uint64_t *)(void *)ring;
    number = __atomic_load_n(latest, __ATOMIC_RELAXED) + 1;
    slot = ring + UNICON_RING + number % UNICON_SLOTS * (UNICON_BYTES + nbytes);
    /* Whoever copies it just now sees that it is going, before any byte of it changes. */
    __atomic_store_n((uint64_t *)(void *)slot, (uint64_t)0, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_RELEASE);
    memcpy(slot + UNICON_BYTES, value, nbytes);
    __atomic_store_n((int64_t *)(void *)(slot + 8), unicon_now_ns(), __ATOMIC_RELAXED);
    __atomic_store_n((uint64_t *)(void *)slot, number, __ATOMIC_RELEASE);
    __atomic_store_n(latest, number, __ATOMIC_RELEASE);
    /* The number is there before the flags are read; a sleeper sets its flag before it reads the
     * number. One of the two sees the other. */
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    sleepers = (uint64_t *)(void *)(ring + UNICON_SLEEPERS);
    for (i = 0; i < 8; i++)
        asleep |= __atomic_load_n(&sleepers[i], __ATOMIC_RELAXED);
    if (asleep != 0 && syscall(SYS_futex, latest, 1 /* FUTEX_WAKE */, INT_MAX, NULL, NULL, 0) == 0
        && ++segment->in_vain % 1000 == 0)
        unicon_clear_dead(segment, ring + UNICON_SLEEPERS);
    return 0;
}

static inline uint64_t *unicon_latest(const struct unicon_reader *reader)
{
    return (uint64_t *)(void *)(reader->segment.memory
                                + reader->segment.form->starts[reader->group]);
}

/* Take the newest value: 1 it is copied, whole; 0 it has been taken before, or there is none. */
static inline int unicon_take(struct unicon_reader *reader, int group, void *value)
{
    unsigned char *slot;
    uint64_t *latest, number;
    int64_t stamp_ns;
    int tries;
    if (reader->segment.memory == NULL || reader->group != group)
        return unicon_fail(&reader->segment, "is closed, or is read as another group", 0);
    latest = unicon_latest(reader);
    for (tries = 0; tries < UNICON_TRIES; tries++) {
        number = __atomic_load_n(latest, __ATOMIC_ACQUIRE);
        if (number == reader->number)
            return 0;
        slot = (unsigned char *)latest + UNICON_RING
               + number % UNICON_SLOTS * (UNICON_BYTES + reader->nbytes);
        if (__atomic_load_n((uint64_t *)(void *)slot, __ATOMIC_ACQUIRE) != number)
            continue;
        memcpy(reader->scratch, slot + UNICON_BYTES, reader->nbytes);
        stamp_ns = __atomic_load_n((int64_t *)(void *)(slot + 8), __ATOMIC_RELAXED);
        __atomic_thread_fence(__ATOMIC_ACQUIRE); /* all of it is read before the number again */
        if (__atomic_load_n((uint64_t *)(void *)slot, __ATOMIC_RELAXED) != number)
            continue;
        memcpy(value, reader->scratch, reader->nbytes);
        if (reader->number != 0)
            reader->skipped += number - reader->number - 1;
        reader->number = number;
        reader->stamp_ns = stamp_ns;
        return 1;
    }
    reader->starved++;
    return 0;
}

/* Sleep until a value is there that has not been taken: 1; 0 after `timeout` [s] or a signal; -1
 * where no more readers can sleep. */
static inline int unicon_wait(struct unicon_reader *reader, double timeout)
{
    const int64_t start = unicon_now_ns();
    uint64_t *latest;
    unsigned char *flag;
    double left;
    struct timespec slice = {0, 0};
    int there, signal_came = 0;
    if (reader->segment.memory == NULL)
        return unicon_fail(&reader->segment, "is closed", 0);
    latest = unicon_latest(reader);
    if (__atomic_load_n(latest, __ATOMIC_ACQUIRE) != reader->number)
        return 1;
    if (reader->place < 0) {
        int place = 0;
        while (place < UNICON_MAX_SLEEPERS && !unicon_lock(reader->segment.fd, F_WRLCK, UNICON_PLACES + place))
            place++;
        if (place == UNICON_MAX_SLEEPERS)
            return unicon_fail(&reader->segment, "64 readers sleep already; poll it", 0);
        reader->place = place;
    }
    flag = (unsigned char *)latest + UNICON_SLEEPERS + reader->place;
    for (;;) {
        __atomic_store_n(flag, (unsigned char)1, __ATOMIC_RELAXED);
        __atomic_thread_fence(__ATOMIC_SEQ_CST); /* see unicon_publish */
        there = __atomic_load_n(latest, __ATOMIC_ACQUIRE) != reader->number;
        left = timeout - (double)(unicon_now_ns() - start) * 1e-9;
        if (there || signal_came || !(left > 0.0))
            break;
        /* 10 ms at most: a writer in Python has no fence on x86, and whatever happens, the value
         * is seen then. */
        slice.tv_nsec = left < 0.01 ? (long)(left * 1e9) : 10000000L;
        signal_came = syscall(SYS_futex, latest, 0 /* FUTEX_WAIT */, (uint32_t)reader->number,
                              &slice, NULL, 0) != 0
                      && errno == EINTR;
    }
    __atomic_store_n(flag, (unsigned char)0, __ATOMIC_RELAXED);
    return there;
}

/* Let a reader go. Safe to call twice. */
static inline void unicon_detach(struct unicon_reader *reader)
{
    if (reader->segment.memory != NULL && reader->place >= 0)
        ((unsigned char *)unicon_latest(reader))[UNICON_SLEEPERS + reader->place] = 0;
    unicon_close(&reader->segment);
    free(reader->scratch);
    reader->scratch = NULL;
}

static inline int unicon_attach(struct unicon_reader *reader, const char *name, int group,
                                uint64_t nbytes, const struct unicon_form *forms, int num_forms)
{
    memset(reader, 0, sizeof *reader);
    reader->forms = forms;
    reader->num_forms = num_forms;
    reader->group = group;
    reader->nbytes = nbytes;
    reader->place = -1;
    if (unicon_map(&reader->segment, name, forms, num_forms) != 0)
        return -1;
    reader->scratch = (unsigned char *)malloc(nbytes);
    if (reader->segment.form->starts[group] == 0 || reader->scratch == NULL) {
        unicon_fail(&reader->segment, reader->scratch ? "has no such group" : "no memory", 0);
        unicon_detach(reader);
        return -1;
    }
    return 0;
}

/* Whether the writer lives: 1, 0 dead; where a new one has the name, its segment is taken up, and
 * numbers begin anew. -1: the new one cannot be read. */
static inline int unicon_alive(struct unicon_reader *reader)
{
    struct unicon_reader next;
    const char *name;
    if (reader->segment.memory != NULL && unicon_writer_lives(reader->segment.fd))
        return 1;
    if (reader->segment.memory == NULL || !unicon_replaced(&reader->segment))
        return 0;
    name = strchr(reader->segment.path + sizeof UNICON_FOLDER "/unicon", '-') + 1;
    if (unicon_attach(&next, name, reader->group, reader->nbytes, reader->forms,
                      reader->num_forms) != 0) {
        memcpy(reader->segment.problem, next.segment.problem, sizeof next.segment.problem);
        return unicon_replaced(&reader->segment) ? -1 : 0; /* 0: it has gone again */
    }
    next.skipped = reader->skipped;
    next.starved = reader->starved;
    next.stamp_ns = reader->stamp_ns;
    unicon_detach(reader);
    *reader = next;
    return unicon_writer_lives(reader->segment.fd);
}
