/* Rings: one process publishes a group's value, others take the newest one whole, or sleep until
 * there is one; the same in every header that `unicon states --header` writes. Where a fence stands,
 * and why, is told in docs/reference/states.md. */

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

static inline int64_t unicon_now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
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
        while (place < UNICON_MAX_SLEEPERS
               && !unicon_lock(reader->segment.fd, F_WRLCK, UNICON_PLACES + place))
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
