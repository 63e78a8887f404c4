"""Kinds of the fuzz around safety: starts, safety blocks, scenes, `unicon preflight`."""

from __future__ import annotations

import contextlib
import io
import os
import random
import time
from pathlib import Path
from typing import Any

import numpy as np
from mutate import mutate_bytes, mutate_tree, to_text
from reading import Reader, tree, whole, write
from seeds import ARGUMENTS, ONE_BLOCK, PLATFORMS, SAFETY, SCENES, STARTS

from unicon_base.errors import UniconError
from unicon_core.models.loaded import import_mujoco
from unicon_core.preflight import wiggle
from unicon_core.workflow import load_document
from unicon_core.workflow.members import read_platforms
from unicon_ros.cli import main as cli
from unicon_ros.cli import preflight as looked

__all__ = ["preflight", "safety", "scene", "start"]


def bounds(folder: Path) -> Path:
    """Write the bounds that `observation_stop` of the seed reads."""
    path = folder / "good.npz"
    np.savez(path, lower=np.full(3, -1.0, np.float32), upper=np.full(3, 1.0, np.float32))
    return path


def start(dice: random.Random, folder: Path) -> Reader:
    """A robot's workflow, with gates, approach and the stops of its set."""
    path, file = folder / "workflow.yaml", bounds(folder)
    if dice.random() < 0.3:
        path.write_text(STARTS, "utf-8")
        raw = mutate_bytes(file.read_bytes(), dice)
        file.write_bytes(raw)
    else:
        write(path, STARTS, dice)
    return lambda: whole(path, platform="fake_robot")


def safety(dice: random.Random, folder: Path) -> Reader:
    """One to three safety blocks with mutated options, ticked a few times; and `safety:` itself."""
    path = folder / "workflow.yaml"
    blocks = [mutate_options(dice.choice(SAFETY), dice) for _ in range(dice.choice((1, 1, 2, 3)))]
    form: Any = {"only": blocks} if dice.random() < 0.3 else blocks
    if dice.random() < 0.1:
        form = mutate_tree({"only": blocks}, dice)
    path.write_text(ONE_BLOCK + to_text({"safety": form}), "utf-8")
    bounds(folder)
    platform = dice.choice(("fake", "fake_robot"))
    return lambda: whole(path, platform=platform, ticks=5)


def mutate_options(use: str, dice: random.Random) -> Any:
    """Return a block of a workflow, mostly with changed options, sometimes changed itself."""
    block = tree(use)
    if dice.random() < 0.2 or not isinstance(block, dict):
        return mutate_tree(block, dice)
    return {name: mutate_tree(options, dice) for name, options in block.items()}


def scene(dice: random.Random, folder: Path) -> Reader:
    """What disturbs a simulation, and platforms in a process of their own."""
    path = folder / "workflow.yaml"
    if dice.random() < 0.3:
        write(path, dice.choice(PLATFORMS), dice)
        # No process is started here.
        return lambda: read_platforms(load_document(path, ()))
    write(path, dice.choice(SCENES), dice)
    import_mujoco()
    platform = dice.choice(("fake", "mujoco"))
    return lambda: whole(path, platform=platform, ticks=2)


def preflight(dice: random.Random, folder: Path) -> Reader:
    """Arguments of `unicon preflight`, whose times are cut short; where it moves joints too."""
    path = folder / "workflow.yaml"
    path.write_text(STARTS.replace("rate: 50", "rate: 500"), "utf-8")
    bounds(folder)
    arguments = [os.fspath(path), "--seconds", "0.01"]
    for _ in range(dice.choice((1, 2, 2, 3, 4))):
        arguments += dice.choice(ARGUMENTS)
        if dice.random() < 0.1 and arguments[-2] != "--json":
            arguments[-1] = mutate_bytes(arguments[-1].encode(), dice).decode("utf-8", "replace")
    import_mujoco()
    looked.SHORTEST, looked.LONGEST = 0.01, 0.1
    wiggle.SETTLE = wiggle.PAUSE = wiggle.SECONDS = 0.004

    def read() -> object:
        begun = time.process_time()
        told = io.StringIO()
        with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
            try:
                given = cli._parser().parse_args(["preflight", *arguments])
                status = given.function(given)
            except SystemExit as error:
                raise UniconError("usage") from error
        # While a platform is open the signal of the alarm ends the command like any other.
        assert time.process_time() - begun < 5.0, "a hang"
        if status:
            raise UniconError(f"status {status}")
        return told

    return read
