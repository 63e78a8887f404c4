/* A controller in C: it reads what a running workflow measures, and publishes commands.
 *
 * The workflow says `store: shm`. Write its header and build this, as C99 or later, or as C++11:
 *
 *     unicon states --header states.h go2_walk
 *     cc -std=c99 -O2 -Wall -I. -o identity identity.c
 *     c++ -std=c++11 -O2 -Wall -I. -x c++ -o identity identity.c
 *     ./identity go2_walk answer          # reads segment go2_walk, publishes segment answer
 *
 * The law holds each joint where it is: the target is the position, half the velocity is kept, and
 * the gains are constant. All of it is exact in float32, so that a test can ask for the very bits.
 * It ends with SIGINT or SIGTERM, and when nobody has written for a second.
 */
#include "states.h"

#include <signal.h>

enum { JOINTS = sizeof(((struct unicon_measured *)0)->joint_pos) / sizeof(float) };
UNICON_ASSERT(sizeof(((struct unicon_command *)0)->joint_pos_target) == JOINTS * sizeof(float));

static const double TIMEOUT = 0.1; /* [s] without a value after which the writer is looked for */
static const int PATIENCE = 10;    /* such times, before it is given up */

static volatile sig_atomic_t stopped;

static void stop(int number)
{
    (void)number;
    stopped = 1;
}

static void identity(const struct unicon_measured *measured, struct unicon_command *command)
{
    /* Through pointers, since more than one robot has one more axis. */
    const float *joint_pos = (const float *)measured->joint_pos;
    const float *joint_vel = (const float *)measured->joint_vel;
    int i;
    for (i = 0; i < JOINTS; i++) {
        ((float *)command->joint_pos_target)[i] = joint_pos[i]; /* [rad] */
        ((float *)command->joint_vel_target)[i] = 0.5f * joint_vel[i];
        ((float *)command->joint_effort_ff)[i] = 0.0f;
        ((float *)command->joint_stiffness)[i] = 40.0f; /* [N m/rad] */
        ((float *)command->joint_damping)[i] = 1.0f;    /* [N m s/rad] */
    }
}

static int run(struct unicon_reader *in, struct unicon_segment *out)
{
    struct unicon_measured measured;
    struct unicon_command command;
    int silent = 0;
    memset(&command, 0, sizeof command);
    while (!stopped && silent < PATIENCE) {
        int there = unicon_wait(in, TIMEOUT);
        if (there < 0)
            return -1;
        if (there == 0) {
            /* Also takes up a new writer, after the one before has died. */
            if (unicon_alive(in) < 0)
                return -1;
            silent++;
        } else if (unicon_take_measured(in, &measured) == 1) {
            identity(&measured, &command);
            if (unicon_publish_command(out, &command) != 0)
                return -1;
            silent = 0;
        }
    }
    return 0;
}

int main(int argc, char **argv)
{
    struct unicon_reader in;
    struct unicon_segment out;
    int status = 1;
    if (argc != 3) {
        fprintf(stderr, "usage: %s SEGMENT_TO_READ SEGMENT_TO_WRITE\n", argv[0]);
        return 2;
    }
    signal(SIGINT, stop);
    signal(SIGTERM, stop);
    if (unicon_attach_measured(&in, argv[1]) != 0) {
        fprintf(stderr, "%s\n", in.segment.problem);
        return 1;
    }
    if (unicon_create(&out, argv[2], UNICON_ONLY_COMMAND) != 0)
        fprintf(stderr, "%s\n", out.problem);
    else if (run(&in, &out) != 0)
        fprintf(stderr, "%s%s\n", in.segment.problem, out.problem);
    else {
        printf("%llu values taken, %llu passed over\n", (unsigned long long)in.number,
               (unsigned long long)in.skipped);
        status = 0;
    }
    unicon_close(&out);
    unicon_detach(&in);
    return status;
}
