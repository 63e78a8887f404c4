"""Native ticks allocate nothing: malloc counted below all of the process, ONNX Runtime left out."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from unicon_core.native.build import COMPILERS

COUNTER = r"""
#include <stddef.h>
#include <stdint.h>
#define COUNTED(name, parameters, ...) \
  void* __libc_##name parameters; \
  void* name parameters { taken += !inside; return __libc_##name(__VA_ARGS__); }
typedef void* Run(void*, const void*, void*);
static __thread int64_t taken, inside;
static Run* network;
COUNTED(malloc, (size_t n), n)
COUNTED(calloc, (size_t n, size_t m), n, m)
COUNTED(realloc, (void* p, size_t n), p, n)
COUNTED(memalign, (size_t a, size_t n), a, n)
void* aligned_alloc(size_t a, size_t n) { return memalign(a, n); }
int posix_memalign(void** p, size_t a, size_t n) { return !(*p = memalign(a, n)); }
int64_t allocations(void) { return taken; }
void wrap(Run* run) { network = run; }
void* run(void* session, const void* options, void* binding) {
  inside = 1;
  void* status = network(session, options, binding);
  inside = 0;
  return status;
}
"""


def count(library: str, folder: Path, ticks: int, allocates: bool) -> int:
    """Return how often ticks of a policy and its safety allocate; runs in a child."""
    import numpy as np
    from test_native_policies import World

    from unicon_core.blocks.safety.stops import TiltStop
    from unicon_core.flow import Zip, as_block
    from unicon_core.flow.block import LinearMap
    from unicon_core.native import network, pieces
    from unicon_core.native.tick import NativeTick

    counter = ctypes.CDLL(library)
    opens = network.open_session

    def opened(*given: Any) -> Any:
        session = opens(*given)
        counter.wrap(ctypes.c_void_p(int(session[0])))
        session[0] = ctypes.cast(counter.run, ctypes.c_void_p).value or 0
        return session

    vars(pieces)["open_session"] = opened
    world = World(folder, "history")
    gravity = world.states["projected_gravity"]
    gravity[...] = (0.0, 0.0, -1.0)
    kept: list[object] = [None]

    def allocate() -> bool:
        kept[0] = np.empty(1000)
        return False

    root = Zip(
        as_block(LinearMap(world.states["joint_vel"], world.states["joint_vel_target"])),
        *([as_block(allocate)] if allocates else []),
        as_block(world.policy),
        as_block(TiltStop(gravity)),
    )
    graph = NativeTick(world.states, sys.exit).compile(root)
    assert "network()" not in graph.source
    step, deferred = graph.step, graph.deferred
    for _ in range(100):
        step()
    before = counter.allocations()
    for _ in range(ticks):
        step()
        deferred()
    return int(counter.allocations() - before)


@pytest.mark.slow
@pytest.mark.skipif(not any(map(shutil.which, COMPILERS)), reason="no C++ compiler")
def test_a_million_native_ticks_allocate_nothing(tmp_path: Path) -> None:
    library = tmp_path / "counter.so"
    command = ["cc", "-x", "c", "-", "-shared", "-fPIC", "-O1", "-o", str(library)]
    subprocess.run(command, input=COUNTER, text=True, check=True)
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path, "XDG_CACHE_HOME": str(tmp_path)}
    environment["LD_PRELOAD"] = str(library)

    def found(ticks: int, allocates: bool) -> int:
        values = f"{str(library)!r}, Path({str(tmp_path)!r}), {ticks}, {allocates}"
        code = f"from test_native_allocations import *; print(count({values}))"
        words = [sys.executable, "-c", code]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return int(done.stdout)

    assert found(1000, True) >= 1000
    assert found(1_000_000, False) == 0
