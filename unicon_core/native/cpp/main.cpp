// The controller as a program beside a run with `store: shm`, which has robot, safety and ROS, and
// block `external` in its flow. Takes what that run measures, and publishes commands each period:
//
//   unicon states --header states.h RUN
//   drive ONNXRUNTIME FOLDER SEGMENT_TO_READ SEGMENT_TO_WRITE
//
// Ends with 0 after the flow's end, SIGINT or SIGTERM, with 3 after a fault. However it ends, the
// run sees no new commands, and damps after the timeout of `external`.
#include "states.h"

#include "controller.h"

#include <signal.h>

#ifndef SILENCE_NS
#define SILENCE_NS 200000000  // it ends when what was measured last is older
#endif

static const int64_t PERIOD_NS = (int64_t)(UNICON_PERIOD * 1e9 + 0.5);
static const int DAMPING_TICKS = (int)(0.5 / UNICON_PERIOD + 1.0);
static const double PATIENCE = 60.0;  // [s], until the run measures

static volatile sig_atomic_t stopped = 0;

static void stop(int) { stopped = 1; }

static void sleep_until(int64_t due_ns) {
  const timespec due = {(time_t)(due_ns / 1000000000), (long)(due_ns % 1000000000)};
  while (!stopped && clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, 0) == EINTR) {
  }
}

static int failed(const char* what) {
  fprintf(stderr, "drive: %s\n", what);
  return 1;
}

// Attach to the run, and wait for its first value.
static bool attach(unicon_reader* in, const char* name) {
  const int64_t end = unicon_now_ns() + (int64_t)(PATIENCE * 1e9);
  while (unicon_attach_measured(in, name) != 0) {
    if (stopped || unicon_now_ns() > end) return false;
    sleep_until(unicon_now_ns() + 20000000);
  }
  while (unicon_wait(in, 0.1) == 0)
    if (stopped || unicon_now_ns() > end) return false;
  return true;
}

static int drive(unicon_reader* in, unicon_segment* out) {
  unicon_measured measured;
  unicon_command command;
  unicon_tick_input input;
  unicon_tick_output output;
  memset(&command, 0, sizeof command);
  int result = 0, damping = DAMPING_TICKS;
  for (int64_t due = unicon_now_ns(); !stopped; sleep_until(due)) {
    unicon_take_measured(in, &measured);
    if (unicon_now_ns() - in->stamp_ns > SILENCE_NS) return failed("the run measures nothing new");
#define TAKE(field)                                           \
  static_assert(sizeof input.field == sizeof measured.field); \
  memcpy(&input.field, &measured.field, sizeof input.field);
    UNICON_TICK_INPUT(TAKE)
    result = unicon_step(&input, &output);
#define GIVE(field)                                           \
  static_assert(sizeof output.field == sizeof command.field); \
  memcpy(&command.field, &output.field, sizeof command.field);
    UNICON_TICK_OUTPUT(GIVE)
    if (unicon_publish_command(out, &command) != 0) return failed(out->problem);
    if (result == UNICON_DONE) break;
    if (result > 0 && damping == DAMPING_TICKS)
      fprintf(stderr, "drive: fault of block %s\n", unicon_block_name(result));
    if (result > 0 && --damping == 0) return 3;
    due += PERIOD_NS;
    if (due < unicon_now_ns()) due = unicon_now_ns();  // late: no burst of steps behind it
  }
  return 0;
}

int main(int count, char** words) {
  if (count != 5) {
    fprintf(stderr, "usage: %s ONNXRUNTIME FOLDER SEGMENT_TO_READ SEGMENT_TO_WRITE\n", words[0]);
    return 2;
  }
  signal(SIGINT, stop);
  signal(SIGTERM, stop);
  const char* wrong = unicon_open(words[1], words[2]);
  if (wrong) return failed(wrong);
  unicon_reader in;
  unicon_segment out;
  if (!attach(&in, words[3])) return failed(in.segment.problem);
  int status = 1;
  if (unicon_create(&out, words[4], UNICON_ONLY_COMMAND) == 0)
    status = drive(&in, &out);
  else
    failed(out.problem);
  unicon_close(&out);
  unicon_detach(&in);
  return status;
}
