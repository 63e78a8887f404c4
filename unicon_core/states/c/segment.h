/* Segments: making one, finding one, and who lives; the same in every header that `unicon states
 * --header` writes. C99 or C++11, gcc or clang, Linux, 64 bits. docs/reference/states.md tells the format. */

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

static inline int unicon_fail(struct unicon_segment *segment, const char *what, int code)
{
    snprintf(segment->problem, sizeof segment->problem, "%s: %s%s%s", segment->path, what,
             code ? ": " : "", code ? strerror(code) : "");
    return -1;
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
    /* Byte 0 is asked for, not taken: whoever looks just now must not think that the writer lives.
     * Somebody else who removes it has byte 1 for a moment. */
    for (tries = 0; tries < 20 && !dead && !unicon_writer_lives(fd); tries++) {
        if (tries > 0)
            nanosleep(&nap, NULL);
        dead = unicon_lock(fd, F_WRLCK, 1);
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
