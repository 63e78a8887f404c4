// `replay FOLDER ONNXRUNTIME` runs recorded inputs and compares the outputs: bit for bit with the
// ONNX Runtime and CPU features of the recording, else within 1e-5; prints how long a step took.
// vectors.bin begins with a line of ticks, whether the last one is done, bytes of input and output,
// version and the p50, p99 and maximum of Python's tick without recv and send [us], and one of CPU
// features as in /proc/cpuinfo.
#include "controller.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

static std::string features() {
  std::ifstream file("/proc/cpuinfo");
  std::string line;
  while (std::getline(file, line))
    if (!line.rfind("flags", 0) || !line.rfind("Features", 0)) return line;
  return "";
}

int main(int count, char** words) {
  std::string folder = count > 1 ? words[1] : ".", line, version, cpu;
  std::ifstream file(folder + "/vectors.bin", std::ios::binary);
  std::getline(file, line);
  std::getline(file, cpu);
  size_t ticks = 0, done = 0, in = 0, out = 0;
  double python[3] = {};
  std::istringstream(line) >> ticks >> done >> in >> out >> version >> python[0] >> python[1] >>
      python[2];
  std::vector<unicon_tick_input> inputs(ticks);
  std::vector<unicon_tick_output> outputs(ticks);
  file.read((char*)inputs.data(), (std::streamsize)(ticks * in));
  file.read((char*)outputs.data(), (std::streamsize)(ticks * out));
  if (!file || !ticks || in != sizeof inputs[0] || out != sizeof outputs[0]) {
    fprintf(stderr, "replay: %s/vectors.bin is absent, cut off or another's\n", folder.c_str());
    return 1;
  }
  const char* wrong = unicon_open(count > 2 ? words[2] : "libonnxruntime.so", folder.c_str());
  if (wrong) {
    fprintf(stderr, "replay: %s\n", wrong);
    return 1;
  }
  std::string here = unicon_onnxruntime();
  bool exact = (here.empty() || here == version) && cpu == features();
  if (!exact)
    printf("recorded with onnxruntime %s, here %s; %s CPU features: compared within 1e-5\n",
           version.c_str(), here.c_str(), cpu == features() ? "the same" : "other");
  std::vector<double> took;
  for (size_t tick = 0; tick < ticks; ++tick) {
    unicon_tick_output found;
    auto begun = std::chrono::steady_clock::now();
    int result = unicon_step(&inputs[tick], &found);
    std::chrono::duration<double, std::micro> passed = std::chrono::steady_clock::now() - begun;
    took.push_back(passed.count());
    const float *one = (const float*)&found, *other = (const float*)&outputs[tick];
    bool same = exact ? !memcmp(one, other, out) : true;
    for (size_t i = 0; i < out / sizeof(float) && !exact; ++i)
      same &= fabsf(one[i] - other[i]) <= 1e-5f;
    if (same && result == (done && tick + 1 == ticks ? UNICON_DONE : 0)) continue;
    fprintf(stderr, "replay: tick %zu: %s (%d %s)\n", tick, same ? "result" : "another output",
            result, unicon_block_name(result));
    return 1;
  }
  printf("%zu ticks: equal %s\n", ticks, exact ? "bit for bit" : "within 1e-5");
  std::sort(took.begin(), took.end());
  auto share = [&](double of) { return took[(size_t)(of * (double)(ticks - 1))]; };
#define SPREAD "p50 %.1f, p99 %.1f, maximum %.1f"
  printf("a step [us]: " SPREAD "; Python's: " SPREAD "\n", share(0.5), share(0.99), share(1.0),
         python[0], python[1], python[2]);
  return 0;
}
