"""Prints a state of a running workflow, in plain Python: neither unicon nor NumPy is needed.

python read_states.py SEGMENT STATE [TIMES]     # with store: shm; see docs/reference/states.md
"""

import ctypes
import json
import math
import mmap
import os
import platform
import struct
import sys
import time

TYPES = "bool float16 float32 float64 int8 int16 int32 int64 uint8 uint16 uint32 uint64"
CODES = dict(zip(TYPES.split(), "?efdbhiqBHIQ"))
X86 = platform.machine() == "x86_64"  # keeps the order of loads by itself, others need a fence
fence = (lambda _: None) if X86 else ctypes.CDLL("libatomic.so.1").atomic_thread_fence


def find(memory, state):
    """Return where the state's group begins, its length, and place and format of the state."""
    magic, version, order, _, _, size, length, _ = struct.unpack_from("<8sIIqQQQ64s", memory)
    if (magic, version, order, size) != (b"UNICONSH", 1, 0x01020304, len(memory)):
        sys.exit("this is not a segment of unicon, or of another version")
    start = -(-(128 + length) // 64) * 64
    for group in json.loads(memory[128 : 128 + length]).values():
        at, places = 0, {}
        for dtype in dict.fromkeys(["float32", *(spec["dtype"] for spec in group["states"])]):
            for spec in (spec for spec in group["states"] if spec["dtype"] == dtype):
                form = f"<{math.prod(spec['shape']) * (group['num_robots'] or 1)}{CODES[dtype]}"
                places[spec["name"]] = at, form
                at += struct.calcsize(form)
            at = -(-at // 64) * 64
        nbytes = max(at, 64)
        if state in places:
            return start, nbytes, *places[state]
        start += 128 + 4 * (64 + nbytes)
    return sys.exit(f"no state {state!r} in this segment")


name, state, *times = sys.argv[1:] if len(sys.argv) > 2 else sys.exit(__doc__)
with open(f"/dev/shm/unicon-{os.getuid()}-{name}", "rb") as file:
    memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
words = memoryview(memory).cast("Q")  # each is loaded at once
start, nbytes, at, form = find(memory, state)
while words[start // 8] == 0:  # nothing is published yet
    time.sleep(0.01)
for _ in range(int(times[0]) if times else 10):
    number, slot, before = 1, start, 0
    while not before == number == words[slot // 8]:  # before and after: it is whole
        number = words[start // 8]
        slot = start + 128 + number % 4 * (64 + nbytes)
        before, stamp = words[slot // 8], words[slot // 8 + 1]
        fence(5)
        values = struct.unpack_from(form, memory, slot + 64 + at)
        fence(5)
    print(number, f"{(time.monotonic_ns() - stamp) / 1e6:.1f} ms old:", *values, flush=True)
    time.sleep(0.1)
