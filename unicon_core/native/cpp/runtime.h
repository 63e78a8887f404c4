// What every exported controller has: ONNX Runtime by its C interface, ticks, faults and damping.
// controller.cpp includes it behind the tick.
#include <dlfcn.h>
#include <string.h>

#include <stdexcept>
#include <string>
#include <vector>

// -- ONNX Runtime: its functions by their place in the table of the interface (OrtApi) -----------

static void* const* api = 0;
static const char* version = "";

static inline void keep(void* object) {  // as long as the process: a step uses it
  static auto& kept = *new std::vector<void*>;
  kept.push_back(object);
}

template <class... A> static void ort(int place, A... arguments) {
  void* status = ((void* (*)(A...))api[place])(arguments...);
  if (!status) return;
  keep(status);
  throw std::runtime_error(((const char* (*)(void*))api[GetErrorMessage])(status));
}

template <class... A> static void* made(int place, A... arguments) {
  void* out = 0;
  ort(place, arguments..., &out);
  keep(out);
  return out;
}

static inline void load(const char* library) {
  struct Base {
    void* const* (*table)(uint32_t);
    const char* (*version)();
  };
  void* opened = dlopen(library, RTLD_NOW | RTLD_LOCAL);
  void* base = opened ? dlsym(opened, "OrtGetApiBase") : 0;
  if (!base) throw std::runtime_error(dlerror());
  const Base* found = ((const Base* (*)())base)();
  api = found->table(VERSION);
  if (!api) throw std::runtime_error(std::string(library) + " is too old");
  version = found->version();
}

struct Tensor {
  int bind;
  const char* name;
  void* data;
  size_t bytes;
  int type;
  std::vector<int64_t> shape;
};

static inline void network(int64_t* session, const std::string& path, const std::vector<Tensor>& tensors) {
  static void* const environment = made(CreateEnv, SEVERE, "unicon");
  void* options = made(CreateSessionOptions);
  for (auto& option : OPTIONS) ort(option[0], options, option[1]);
  ort(AddSessionConfigEntry, options, SPINNING, "0");
  void* opened = made(CreateSession, environment, path.c_str(), options);
  void* binding = made(CreateIoBinding, opened);
  void* memory = made(CreateCpuMemoryInfo, 0, 0);
  for (auto& each : tensors) {
    void* value = made(CreateTensorWithDataAsOrtValue, memory, each.data, each.bytes,
                       each.shape.data(), each.shape.size(), each.type);
    ort(each.bind, binding, each.name, value);
  }
  session[0] = (int64_t)api[RunWithBinding];
  session[1] = (int64_t)opened;
  session[2] = (int64_t)binding;
}

// -- ticks ---------------------------------------------------------------------------------------

static const int JOINTS = sizeof(unicon_tick_output::joint_damping) / sizeof(float);
static bool opened = false;
static void open_all(const char* library, const std::string& folder);

static bool sound(const unicon_tick_output& command) {
  bool holds = true;
  each(JOINTS) {
    holds &= finite(command.joint_pos_target[i]) && finite(command.joint_vel_target[i]);
    holds &= finite(command.joint_effort_ff[i]) && finite(command.joint_stiffness[i]);
    holds &= finite(command.joint_damping[i]);
  }
  return holds;
}

// As the damping command of unicon: targets stay, stiffness falls, damping is the robot's.
static void damp(unicon_tick_output* output) {
  const float* measured = unicon_states()->joint_pos;
  arena.share = larger(arena.share - UNICON_PERIOD / UNICON_FADE, 0.0);
  *output = *sent;
  each(JOINTS) {
    if (!arena.any && finite(measured[i])) sent->joint_pos_target[i] = measured[i];
    output->joint_pos_target[i] = sent->joint_pos_target[i];
    output->joint_vel_target[i] = output->joint_effort_ff[i] = 0.0f;
    output->joint_stiffness[i] = sent->joint_stiffness[i] * (float)arena.share;
    if (finite(damping[i])) output->joint_damping[i] = damping[i];
  }
  arena.any = 1;
}

extern "C" {

struct unicon_tick_states* unicon_states(void) { return (unicon_tick_states*)arena.memory; }

const char* unicon_onnxruntime(void) { return version; }

const char* unicon_block_name(int number) {
  return number < 1 || number > BLOCKS ? "" : NAMES[number - 1];
}

size_t unicon_size(void) { return sizeof arena; }

void unicon_snapshot(void* memory) { memcpy(memory, &arena, sizeof arena); }

void unicon_restore(const void* memory) { memcpy(&arena, memory, sizeof arena); }

void unicon_reset(void) {
  memcpy(arena.memory, IMAGE, sizeof IMAGE);
  arena.share = 1.0;
  arena.any = arena.fault = 0;
}

const char* unicon_open(const char* library, const char* folder) {
  static std::string wrong;
  opened = false;
  unicon_reset();
  try {
    open_all(library, folder);
  } catch (const std::exception& error) {
    wrong = error.what();
    return wrong.c_str();
  }
  opened = true;
  return 0;
}

int unicon_step(const struct unicon_tick_input* input, struct unicon_tick_output* output) {
  bool done = false;
  if (!opened) arena.fault = 1;
#define TAKE(field) memcpy(&unicon_states()->field, &input->field, sizeof input->field);
#define GIVE(field) memcpy(&command.field, &unicon_states()->field, sizeof command.field);
  UNICON_TICK_INPUT(TAKE)
  if (!arena.fault) done = step() > 0;
  unicon_tick_output command = *sent;
  UNICON_TICK_OUTPUT(GIVE)
  if (!arena.fault && !sound(command)) arena.fault = SEND;
  if (!arena.fault) {
    *output = *sent = command;
    arena.any = 1;
    done |= deferred() > 0;
  }
  *ticks += 1;
  if (arena.fault) damp(output);
  return arena.fault ? (int)arena.fault : done ? UNICON_DONE : 0;
}

}  // extern "C"
