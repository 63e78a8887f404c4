"""Rollout: one run on one platform, in a process of its own (`python -m`, see `processes`).

It reads its task from standard input as JSON, and leaves `NAME.npz` with the states of every tick
and `NAME.json`, or nothing where the engine takes the process with it. The simulated time is told
through a pipe meanwhile. What the engine prints goes to the log that its parent made.
"""

from __future__ import annotations

import json
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import MissingDependencyError, UniconError
from unicon_core.flow import Block, Stage
from unicon_ros.transfer.figures import KEPT, finite_rows, moved

if TYPE_CHECKING:
    from unicon_core.workflow import Program

__all__ = ["Keeper", "roll_out"]

TELL = 10
"""Ticks between two words to the parent; together shorter than what it takes at a look."""
REPORTED = (
    *("ticks", "duration_s", "wall_s", "startup_s", "tick_us", "faults", "ended", "fell"),
    *("tilt_deg", "base_displacement_m", "safety", "safety_left_out", "sha256_commands"),
)
"""Of `unicon run --report`."""


class Keeper:
    """Keeps the states of every tick, behind `send`.

    Args:
        pipe: file descriptor that the simulated time in [s] is told to, non-blocking.
    """

    def __init__(self, pipe: int) -> None:
        self._pipe = pipe
        self._rows: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._count = 0
        self._columns: dict[str, slice] = {}

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the block that keeps them."""
        views = [(name, program.states[name]) for name in KEPT]
        start, period = 0, program.period
        for name, view in views:
            self._columns[name] = slice(start, start + view.size)
            start += view.size
        self._rows = np.zeros((2048, start), np.float32)
        places = [(self._columns[name], view) for name, view in views]

        def keep() -> None:
            if self._count == len(self._rows):
                self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
            row = self._rows[self._count]
            for place, view in places:
                row[place] = view
            self._count += 1
            if self._count % TELL == 0:
                with suppress(OSError):  # full, or nobody reads
                    os.write(self._pipe, b"%.3f\n" % (self._count * period))

        return {Stage.OBSERVE: [Block("transfer", keep, reads=KEPT)]}

    def states(self) -> dict[str, NDArray[np.float64]]:
        """Return what was kept, name to shape (n, d)."""
        rows = self._rows[: self._count].astype(np.float64)
        return {name: rows[:, place] for name, place in self._columns.items()}


def roll_out(task: dict[str, Any]) -> dict[str, Any]:
    """Run a task; return what its JSON has.

    Args:
        task: `workflow`, `overrides`, `duration`, `files` (path without suffix), `pipe`.

    Raises:
        UniconError: it cannot be run.
    """
    from unicon_core.platforms.platform import info_of
    from unicon_core.runtime import run
    from unicon_core.workflow import Program, load_document
    from unicon_ros.recording.facts import network_hash, versions_here

    keeper = Keeper(task["pipe"])
    document = load_document(task["workflow"], task["overrides"])
    program = Program(document, hooks=[keeper.hook])
    told = {
        "robot": program.robot.name,
        "period_s": program.period,
        "policies": {name: network_hash(one.model) for name, one in program.policies.items()},
        "info": dict(info_of(program.platform)),
    }
    warnings: list[str] = []
    report = run(program, duration=task["duration"], speed="max", warn=warnings.append)
    # What is behind these ticks is no run any more: the robot is damped after a fault.
    states = {name: rows[: report.ticks] for name, rows in keeper.states().items()}
    if not report.ticks and not report.faults:
        raise UniconError(
            f"it has no tick: they are {program.period:g} s; give a longer --duration"
        )
    joints = np.array(program.robot.joint_names)
    values = report.to_dict()
    told |= {name: values[name] for name in REPORTED}
    told["warnings"], told["versions"] = warnings, versions_here()
    told["kept_rows"] = len(states["joint_pos"])
    told["finite_rows"] = count = finite_rows(states)
    told |= moved({name: rows[:count] for name, rows in states.items()}, program.period)
    whole: dict[str, Any] = {"dt": program.period, "joint_names": joints} | states
    np.savez_compressed(
        f"{task['files']}.npz",
        robot=program.robot.name,
        workflow=program.name,
        platform=report.platform,
        **whole,
    )
    return told


def main() -> int:
    """Run the task of standard input; exit status 0 whatever became of it, if that is written."""
    task = json.loads(sys.stdin.buffer.read())
    os.set_blocking(task["pipe"], False)
    try:
        told = {"outcome": "ran", "text": ""} | roll_out(task)
    except MissingDependencyError as error:
        told = {"outcome": "missing", "text": str(error)}
    except UniconError as error:
        told = {"outcome": "refused", "text": str(error)}
    except OSError as error:
        told = {
            "outcome": "refused",
            "text": f"{error.filename or task['files']}: {error.strerror}",
        }
    half = Path(f"{task['files']}.json.half")
    half.write_text(json.dumps(told, default=str) + "\n", encoding="utf-8")
    half.replace(f"{task['files']}.json")  # whole or not at all
    return 0


if __name__ == "__main__":
    sys.exit(main())
