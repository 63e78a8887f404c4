#include <algorithm>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <limits>
#include <time.h>

static_assert(FLT_EVAL_METHOD == 0, "float32 has to be computed as float32");
#define each(n) for (int64_t i = 0; i < (int64_t)(n); ++i)
#define DONE(x) return (x) ? 1 : 0

template <class T, int64_t S> struct View {
  T* p;
  T& operator[](int64_t i) const { return p[i * S]; }
};

// As NumPy's maximum and minimum: NaN goes through, of two equal numbers the second one counts.
template <class T> static inline T greater(T a, T b) { return a != a ? a : a > b ? a : b; }
template <class T> static inline T lesser(T a, T b) { return a != a ? a : a < b ? a : b; }

template <class A, class B> static inline bool within(A a, B low, B high, int64_t n) {
  bool holds = true;
  each(n) holds &= a[i] >= low[i] && a[i] <= high[i];
  return holds;
}

template <class T> static void compare(int way, const T* a, const T* b, T* out, int64_t n) {
  each(n) out[i] = way ? lesser(a[i], b[i]) : greater(a[i], b[i]);
}

extern "C" void unicon_compare(int way, const void* a, const void* b, void* out, int64_t n) {
  if (way < 2) compare(way, (const float*)a, (const float*)b, (float*)out, n);
  else compare(way - 2, (const double*)a, (const double*)b, (double*)out, n);
}

static int64_t* v;
static int64_t* T;
static int64_t (*call)(int64_t);

// The clock of time.perf_counter_ns on Linux.
static inline int64_t now() {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}
