// Replays the recorded inputs and compares the commands: `replay FOLDER ONNXRUNTIME`.
//
// Bit for bit with the ONNX Runtime and CPU features of the recording, else within 1e-5. The first
// line of vectors.bin names: ticks, whether the last one is done, bytes of an input and an output,
// version of ONNX Runtime and CPU features.
#include "controller.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <set>
#include <sstream>
#include <string>
#include <vector>

static std::string features() {
  std::ifstream file("/proc/cpuinfo");
  std::string line, word, joined;
  std::set<std::string> found;
  while (found.empty() && std::getline(file, line)) {
    if (line.rfind("flags", 0) && line.rfind("Features", 0)) continue;
    std::istringstream words(line.substr(line.find(':') + 1));
    while (words >> word)
      for (const char* kind : {"amx", "asimd", "avx", "bf16", "fma", "i8mm", "sve"})
        if (!word.rfind(kind, 0)) found.insert(word);
  }
  for (auto& each : found) joined += (joined.empty() ? "" : ",") + each;
  return joined.empty() ? "none" : joined;
}

static int fail(const std::string& text) {
  fprintf(stderr, "replay: %s\n", text.c_str());
  return 1;
}

int main(int count, char** words) {
  if (count != 3) return fail("give FOLDER ONNXRUNTIME");
  std::ifstream file(std::string(words[1]) + "/vectors.bin", std::ios::binary);
  std::string line, version, cpu;
  std::getline(file, line);
  size_t ticks = 0, done = 0, in = 0, out = 0;
  std::istringstream(line) >> ticks >> done >> in >> out >> version >> cpu;
  if (!ticks || in != sizeof(unicon_tick_input) || out != sizeof(unicon_tick_output))
    return fail("vectors.bin is absent or of another controller");
  std::vector<unicon_tick_input> inputs(ticks);
  std::vector<unicon_tick_output> outputs(ticks);
  file.read((char*)inputs.data(), (std::streamsize)(ticks * in));
  file.read((char*)outputs.data(), (std::streamsize)(ticks * out));
  if (!file) return fail("vectors.bin is cut off");
  if (const char* wrong = unicon_open(words[2], words[1])) return fail(wrong);
  std::string here = unicon_onnxruntime();
  bool exact = (here.empty() || here == version) && cpu == features();
  if (!exact)
    printf("recorded with onnxruntime %s on %s, here is %s on %s: within 1e-5\n", version.c_str(),
           cpu.c_str(), here.c_str(), features().c_str());
  std::vector<double> times;
  std::vector<char> before(unicon_size());
  float worst = 0.0f;
  for (int pass = 0; pass < 2; ++pass, unicon_reset()) {
    for (size_t tick = 0; tick < ticks; ++tick) {
      unicon_tick_output found;
      if (tick % 100 == 50) {  // a tick that is taken back leaves nothing
        unicon_snapshot(before.data());
        unicon_step(&inputs[ticks - 1 - tick % ticks], &found);
        unicon_restore(before.data());
      }
      auto begin = std::chrono::steady_clock::now();
      int result = unicon_step(&inputs[tick], &found);
      std::chrono::duration<double, std::micro> took = std::chrono::steady_clock::now() - begin;
      times.push_back(took.count());
      std::string where = "tick " + std::to_string(tick) + ": ";
      if (result > 0) return fail(where + "a fault of block " + unicon_block_name(result));
      if ((result == UNICON_DONE) != (done && tick + 1 == ticks))
        return fail(where + "returned " + std::to_string(result));
      if (!memcmp(&found, &outputs[tick], out)) continue;
      const float *one = (const float*)&found, *other = (const float*)&outputs[tick];
      for (size_t i = 0; i < out / sizeof(float); ++i) {
        float apart = fabsf(one[i] - other[i]);
        worst = std::max(worst, apart);
        if (exact ? memcmp(&one[i], &other[i], sizeof(float)) : !(apart <= 1e-5f))
          return fail(where + "element " + std::to_string(i) + " of the output is " +
                      std::to_string(one[i]) + ", recorded is " + std::to_string(other[i]));
      }
    }
  }
  std::sort(times.begin(), times.end());
  if (worst == 0.0f) printf("%zu ticks, twice, equal bit for bit", ticks);
  else printf("%zu ticks, twice, equal within %.2g", ticks, worst);
  printf("; a tick takes %.1f us (p50), %.1f us (p99), %.1f us at most\n", times[times.size() / 2],
         times[times.size() * 99 / 100], times.back());
  return 0;
}
