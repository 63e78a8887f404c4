// Attacks an exported controller: `attack FOLDER ONNXRUNTIME` prints what the test compares.
#include "vectors.h"

#include <math.h>
#include <string.h>

static bool finite_output(const unicon_tick_output& output) {
  bool finite = true;
  for (size_t i = 0; i < sizeof output / sizeof(float); ++i)
    finite &= (bool)isfinite(((const float*)&output)[i]);
  return finite;
}

int main(int, char** words) {
  std::string folder = words[1];
  auto [inputs, expected] = Vectors(folder);
  const size_t ticks = inputs.size();
  unicon_tick_output output;
  const size_t joints = sizeof output.joint_stiffness / sizeof(float);

  CHECK(unicon_step(&inputs[0], &output) == 1);
  CHECK(strstr(unicon_block_name(1), "unicon_open"));
  CHECK(finite_output(output));
  CHECK(!memcmp(output.joint_pos_target, inputs[0].joint_pos, sizeof inputs[0].joint_pos));
  CHECK(!*unicon_block_name(0) && !*unicon_block_name(-1) && !*unicon_block_name(100000));
  CHECK(unicon_open("/nowhere/libonnxruntime.so", folder.c_str()));
  CHECK(unicon_open(words[2], "/nowhere"));
  CHECK(unicon_step(&inputs[0], &output) == 1);
  const char* wrong = unicon_open(words[2], folder.c_str());
  if (wrong) printf("%s\n", wrong);

  std::vector<char> before(unicon_size());
  for (size_t tick = 0; tick < ticks; ++tick) {
    if (tick % 37 == 20) {  // what is taken back, a fault too, leaves nothing
      unicon_snapshot(before.data());
      unicon_tick_input odd = inputs[ticks - 1 - tick];
      memset(&odd, tick % 2 ? 0xff : 0, sizeof odd);
      unicon_step(&odd, &output);
      unicon_restore(before.data());
    }
    int result = unicon_step(&inputs[tick], &output);
    CHECK(result <= 0 && !memcmp(&output, &expected[tick], sizeof output));
  }

  for (size_t good : {(size_t)0, ticks / 2}) {
    unicon_reset();
    for (size_t tick = 0; tick < good; ++tick) unicon_step(&inputs[tick], &output);
    unicon_tick_input nan = inputs[good];
    for (float& each : nan.joint_pos) each = NAN;
    unicon_tick_output last = output;
    int block = unicon_step(&nan, &output);
    CHECK(block > 1 && *unicon_block_name(block));
    printf("%s\n", unicon_block_name(block));
    CHECK(finite_output(output));
    if (good) CHECK(!memcmp(output.joint_pos_target, last.joint_pos_target, 4 * joints));
    for (int tick = 0; tick < 16; ++tick) {  // it stays a fault, and damps
      float most = output.joint_stiffness[0];
      CHECK(unicon_step(&inputs[good], &output) == block);
      CHECK(output.joint_stiffness[0] <= most && finite_output(output));
    }
    for (size_t i = 0; i < joints; ++i)
      CHECK(output.joint_stiffness[i] == 0 && output.joint_damping[i] > 0 &&
            output.joint_vel_target[i] == 0 && output.joint_effort_ff[i] == 0);
  }
  unicon_reset();
  CHECK(unicon_step(&inputs[0], &output) == 0 && !memcmp(&output, &expected[0], sizeof output));
  return failures != 0;
}
