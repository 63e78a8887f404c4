"""Process of one end of a way between stores: `--variant "NAME: writer"` or `"NAME: reader"`."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.store_ways import WAYS, Receiver, Sender, group
from unicon_ros.bench.pipelines.log import Log, Stop, arguments

LONGEST = 0.1  # s of one wait, so that SIGTERM is heard
LARGEST = 1 << 24  # numbers that a float32 holds without loss


def main() -> None:
    """Write at `--state-rate`, or read, until SIGTERM."""
    options = arguments()
    stop = Stop()
    name, _, side = options.variant.rpartition(": ")
    way, states = WAYS[name], group()
    # The log's own name leads to the place, and that of the writer's log begins as the reader's.
    place = options.out.with_name(options.out.stem.partition("_")[0])
    if side == "writer":
        _write(way.sender(place, states), states, 1.0 / options.state_rate, options.out, stop)
    else:
        _read(way.receiver(place, states), states, options.out, stop)


def _write(sender: Sender, states: object, period: float, out: Path, stop: Stop) -> None:
    log = Log(out, "begin", "end")
    data, number, stamp = (getattr(states, name) for name in ("data", "number", "stamp_ns"))
    now, publish = time.time_ns, sender.publish
    due = time.monotonic() + period
    while not stop:
        time.sleep(max(0.0, due - time.monotonic()))
        due = max(due + period, time.monotonic())  # after a hold there is nothing to catch up
        number += 1
        data[:] = int(number) % LARGEST
        begin = now()
        stamp[...] = begin
        publish()
        log.add(begin, now())
    log.save()
    sender.close()


def _read(receiver: Receiver, states: object, out: Path, stop: Stop) -> None:
    log = Log(out, "stamp", "received", "number", "torn", "starved")
    data, number, stamp = (getattr(states, name) for name in ("data", "number", "stamp_ns"))
    while not stop:
        if receiver.receive(LONGEST):
            received = time.time_ns()
            torn = bool(np.any(data != int(number) % LARGEST))
            log.add(int(stamp), received, int(number), torn, receiver.starved)
    log.save()
    receiver.close()


if __name__ == "__main__":
    main()
