"""What the fuzz does to recordings of whole runs and replays, plain bags and UniCon's npz."""

from __future__ import annotations

import random
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from mutate import mutate_bytes, mutate_mcap
from reading import Reader, whole, write
from seeds import REPLAYS

from unicon_core import Program, block
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import open_record
from unicon_lab.recording.import_bag import import_bag
from unicon_lab.recording.imported import import_npz
from unicon_lab.recording.info import export, info_of, info_text
from unicon_lab.recording.run_recording import Recording

__all__ = ["bags", "replays"]


@cache
def _recorded() -> bytes:
    """Return a recording of ten ticks."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        recording = Recording(file, patient=True)
        record = FaultRecord("off", recording=recording)
        hooks = [recording.hook, record.hook]
        flow = block("hold")
        program = Program(robot="go2", platform="fake", rate=50, flow=flow, hooks=hooks)
        runner = Runner(program, RunOptions(speed="max", duration=0.2, warn=str))
        record.attach(runner)
        runner.run()
        return file.read_bytes()


@cache
def _npz() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.npz"
        names = np.array(load_robot("go2").joint_names)
        values = {"states_q": np.ones((9, 12)), "states_quat": np.ones((9, 4)), "rec_dt": 0.02}
        np.savez(file, DOF_NAMES=names, allow_pickle=False, **values)  # type: ignore[arg-type]
        return file.read_bytes()


def _torn(raw: bytes, dice: random.Random) -> bytes:
    return raw[: dice.randrange(len(raw) + 1)] if dice.random() < 0.3 else raw


def _run(dice: random.Random, folder: Path) -> Reader:
    """A recording of a run that `unicon bag` looks into, and a replay reads."""
    raw = _recorded()
    raw = mutate_mcap(raw, dice) if dice.random() < 0.6 else mutate_bytes(raw, dice)
    path = folder / dice.choice(["run.mcap", "run.mcap.partial"])
    path.write_bytes(_torn(raw, dice))

    def read() -> object:
        told = info_text(info_of(path))
        record = open_record(path)
        live = States(record.layout)
        for moment, names in record.kept.items():
            for name in names:
                record.states(name, moment)
            if len(record.ticks):
                record.feed(moment, len(record.ticks) - 1, live)
        export(record, folder / "x.csv")
        return told

    return read


def _bag(dice: random.Random, folder: Path) -> Reader:
    """The same as a plain bag of others, read by rosbags."""
    path = folder / "run.mcap"
    raw = _recorded()
    path.write_bytes(_torn(mutate_bytes(raw, dice), dice))
    go2 = load_robot("go2")
    return lambda: import_bag(path, folder / "fuzzed.out.mcap", go2)


def _unicon(dice: random.Random, folder: Path) -> Reader:
    """A file of UniCon's."""
    path = folder / "run.npz"
    path.write_bytes(_torn(mutate_bytes(_npz(), dice), dice))
    go2 = load_robot("go2")
    return lambda: import_npz(path, folder / "fuzzed.out.mcap", go2)


def replays(dice: random.Random, folder: Path) -> Reader:
    """A workflow that a recording drives, whole or damaged."""
    seed = dice.randrange(len(REPLAYS))
    path = folder / "workflow.yaml"
    write(path, REPLAYS[seed], dice)
    raw = _recorded()
    (folder / "run.mcap").write_bytes(mutate_mcap(raw, dice) if dice.random() < 0.2 else raw)
    platform = ("replay", "fake")[seed]
    return lambda: whole(path, platform=platform, ticks=12)


def bags(dice: random.Random, folder: Path) -> Reader:
    """One of the three."""
    return dice.choice((_run, _bag, _unicon))(dice, folder)
