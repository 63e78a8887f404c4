// What the C++ tests of exports share: a check that counts, and the recorded inputs and outputs.
#pragma once
#include "controller.h"

#include <stdio.h>

#include <fstream>
#include <string>
#include <vector>

static int failures = 0;
#define CHECK(fact) \
  if (!(fact)) { printf("line %d: %s\n", __LINE__, #fact); ++failures; }

struct Vectors {
  std::vector<unicon_tick_input> inputs;
  std::vector<unicon_tick_output> outputs;

  explicit Vectors(const std::string& folder) {
    std::ifstream file(folder + "/vectors.bin", std::ios::binary);
    std::string line;
    std::getline(file, line);
    const size_t ticks = std::stoul(line);
    std::getline(file, line);
    inputs.resize(ticks);
    outputs.resize(ticks);
    file.read((char*)inputs.data(), (std::streamsize)(ticks * sizeof inputs[0]));
    file.read((char*)outputs.data(), (std::streamsize)(ticks * sizeof outputs[0]));
  }
};
