"""Experiment: a workflow in which a robot moves so that a cause shows, behind its safety blocks.

text = experiment_text("go2", "wiggle", "wiggle.yaml")
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import yaml

from unicon_base import AnyDict, UniconError
from unicon_base.resources import find_config
from unicon_core.robots import Robot, load_robot
from unicon_core.robots.load import joints_like
from unicon_lab.diagnose.diagnosis import simulated
from unicon_lab.recording import open_record
from unicon_lab.replay.workflow import recorded_values, robot_of

SIZES = {"drop": 0.25, "wiggle": 0.1, "sway": 0.05, "rest": 0.0}
"""By which joints move at most in [rad], [m] of sliding joints."""
SHARE = 0.25
"""Of a joint's range that a motion takes at most."""
_UNMET = re.compile("twin|button|observation|action|height")
"""In names of safety blocks that read what an experiment lacks, or need a robot on the ground."""


def experiment_text(subject: str, kind: str, file: str, joints: Sequence[str] = ()) -> str:
    """Return the text of a workflow, made of `config/experiments/KIND.yaml`.

    Args:
        subject: name or file of a robot; or a record, whose robot, model, platform, rate, safety
            and median gains the workflow has. A humanoid sways and rests by the record's own flow.
        kind: of `MOTIONS`.
        file: that the text is for, as a shell finds it.
        joints: names and patterns of those that move, all unless given.

    Raises:
        UniconError: there is no such robot or record, or it cannot move so.
    """
    given, said = Path(subject), AnyDict()
    words: AnyDict = {"platform": "mujoco", "platforms": None, "model": None, "rate": 50.0}
    words |= {"stiffness": 1.0, "damping": 1.0}
    if given.suffix == ".mcap" or given.is_dir():
        record = open_record(given)
        robot, scene = simulated(record, given.name, None)
        said = recorded_values(record)
        words |= {key: said[key] for key in ("platform", "platforms") if key in said}
        words |= {"robot": robot_of(record), "rate": round(1.0 / record.period, 3)}
        words |= {"model": str(scene.model_path(robot))} if scene.model else {}
        for word, most in (("stiffness", 2.0), ("damping", 5.0)):
            own = getattr(robot, f"joint_{word}")
            used = record.states(f"joint_{word}") / np.where(own > 0.0, own, 1.0)
            words[word] = round(min(float(np.median(used)) or 1.0, most), 3)
    else:
        robot = load_robot(subject)
        words["robot"] = str(given.absolute()) if given.suffix else subject
    words["safety"] = ["finite", "joint_limits", *["tilt_stop"] * robot.floats]
    if isinstance(said.get("safety"), list):
        words["safety"] = [each for each in said["safety"] if not _UNMET.search(str(each))]
    if kind in ("sway", "rest"):
        balanced = robot.kind == "humanoid" and "policies" in said
        if robot.kind != "quadruped" and not balanced:
            raise UniconError(
                f"robot {robot.name} does not stand by gains; give --kind wiggle or drop, or of a "
                "humanoid the record of a policy that balances it"
            )
        if joints and (balanced or kind == "rest"):
            raise UniconError(f"a {kind} of {robot.name} takes no --joints; leave them out")
        kind += "_of_policy" * balanced
    words |= _moves(robot, SIZES[kind.partition("_")[0]], joints)
    text = {key: json.dumps(value) for key, value in words.items()}
    ours = ("commands", "duration", "name")
    flow = {key: value for key, value in said.items() if key not in ours}
    behind = "\n" + yaml.safe_dump(flow | {"robot": words["robot"]}, sort_keys=False)
    text["file"], text["record"] = map(shlex.quote, (file, file.removesuffix("yaml") + "mcap"))
    template = find_config("experiments", kind).read_text("utf-8")
    filled = Template(template).substitute(text) + behind * kind.endswith("_of_policy")
    return re.sub(r"\n *(model|platforms): null", "", filled)


def _moves(robot: Robot, most: float, patterns: Sequence[str]) -> AnyDict:
    """Return joints, amplitudes, and poses: about which they move, at their end, to lie in."""
    moving = sorted({i for pattern in patterns or ["*"] for i in joints_like(pattern, robot)})
    lower, upper, stand = np.array((robot.lower, robot.upper, robot.default_joint_pos), float)
    size = np.fmin(most, SHARE * (upper - lower)).round(4)
    room = size + 1e-3
    centre = np.fmin(np.fmax(np.nan_to_num(stand), lower + room), upper - room)
    lifted = centre + np.where(upper - centre > centre - lower, size, -size)

    def named(values: Any) -> dict[str, float]:
        return {robot.joint_names[i]: round(float(values[i]), 4) for i in moving}

    return {
        "joints": list(patterns) or ["*"],
        "amplitude": named(size) if np.ptp(size) else float(size[0]),
        "around": "stand" if np.array_equal(centre, stand) else named(centre),
        "lifted": named(lifted),
        "lying": "stand" if np.isnan(robot.rest_joint_pos).any() else "rest",
    }
