"""A Go2 that walks with another policy beside its own, and policies to stand there."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from policy_helpers import write_graph

from unicon_core.flow import Block, Stage
from unicon_core.policies.shadow import ShadowedPolicy
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.report import Report
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_core.workflow.policies import shadowed_in
from unicon_lab.fault_record import FaultRecord

ROOT = Path(__file__).resolve().parents[2]
OURS = ROOT / "config" / "policies" / "go2_velocity"
WORKFLOW = """\
robot: go2
platform: mujoco
policies: {walk: go2_velocity}
rate: 50
commands: [{velocity_command: {constant: [0.6, 0.0, 0.0]}}]
flow: {policy: walk}
"""
LIMIT = 0.2
"""For a tick of B in [s]: a busy machine stops a test for 20 ms and more."""


def older(folder: Path, unused: int = 0, **changes: Any) -> Path:
    """Write the Go2 policy of 2026-11-21, which was trained otherwise; weights of 8 bits.

    Args:
        folder: to write to.
        unused: further inputs, which have no weight.
        changes: of its `policy.yaml`.
    """
    arrays = np.load(Path(__file__).with_name("go2_first_trained.npz"))
    weights = {
        name: arrays[name].astype(np.float32) * arrays[name.replace("weight", "scale")]
        for name in arrays
        if name.startswith("weight")
    }
    layers, inputs, lines = (0, 2, 4, 6), "obs", []
    constants: dict[str, Any] = {}
    for layer in layers:
        constants |= {
            f"w{layer}": weights[f"weight_{layer}"].T.copy(),
            f"b{layer}": arrays[f"bias_{layer}"],
        }
        lines.append(f"m{layer} = MatMul({inputs}, w{layer})")
        last = layer == layers[-1]
        lines.append(f"{'actions' if last else f's{layer}'} = Add(m{layer}, b{layer})")
        if not last:
            lines.append(f"e{layer} = Elu(s{layer})")
        inputs = f"e{layer}"
    folder.mkdir(parents=True, exist_ok=True)
    constants["w0"] = np.pad(constants["w0"], ((0, unused), (0, 0)))
    shapes = {"obs": [1, 45 + unused], "actions": [1, 12]}
    write_graph(folder / "policy.onnx", "\n".join(lines), ["obs"], shapes, constants)
    said = yaml.safe_load((OURS / "policy.yaml").read_text("utf-8"))
    del said["recurrent"], said["sha256"]
    (folder / "policy.yaml").write_text(yaml.safe_dump(said | changes), "utf-8")
    return folder


def same(folder: Path, **changes: Any) -> Path:
    """Write our policy once more, with changes of its `policy.yaml`."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(OURS / "policy.onnx", folder)
    said = yaml.safe_load((OURS / "policy.yaml").read_text("utf-8"))
    (folder / "policy.yaml").write_text(yaml.safe_dump(said | changes), "utf-8")
    return folder


@dataclass
class Ran:
    """What a run left: its report, the policies, and states of every tick, by name."""

    report: Report
    shadowed: ShadowedPolicy
    rows: dict[str, Any] = field(default_factory=dict)
    answers: list[tuple[bool, str]] = field(default_factory=list)
    told: list[str] = field(default_factory=list)

    @property
    def events(self) -> list[str]:
        """What the shadow has noted."""
        return list(self.shadowed.found()["events"])

    @property
    def steps(self) -> Any:
        """Largest step of a target in each tick, in [rad]."""
        return np.abs(np.diff(self.rows["joint_pos_target"], axis=0)).max(axis=1)


Act = Callable[[ShadowedPolicy, Runner], Any]


def ask(shadowed: ShadowedPolicy, _: Runner) -> tuple[bool, str]:
    """Ask for a swap."""
    return shadowed.ask()


def ran(
    path: Path,
    shadow: Any,
    seconds: float,
    acts: Mapping[int, Act] | None = None,
    overrides: Mapping[str, Any] | None = None,
    text: str = WORKFLOW,
    record: FaultRecord | None = None,
    speed: Literal["real", "max"] = "max",
) -> Ran:
    """Run a workflow for so long, and act behind `send` in ticks of these numbers."""
    path.write_text(text)
    if shadow is not None:
        said = dict(shadow) if isinstance(shadow, Mapping) else {"path": str(shadow)}
        overrides = {"shadow": {"walk": {"limit": LIMIT} | said}} | dict(overrides or {})
    rows: dict[str, list[Any]] = {}
    left = dict(acts or {})
    answers: list[Any] = []
    told: list[str] = []

    def hook(program: Program) -> HookBlocks:
        names = [
            n
            for n in program.states
            if n.startswith(("shadow_", "joint_pos", "action", "observation"))
        ]
        rows.update({name: [] for name in names})

        def look() -> None:
            for name in names:
                rows[name].append(program.states[name].copy())
            act = left.pop(len(rows[names[0]]), None)
            if act is not None and shadowed is not None:
                answers.append(act(shadowed, runner))

        return {Stage.OBSERVE: [Block("look", look, endless=True)]}

    hooks = [hook] if record is None else [hook, record.hook]
    program = Program(load_document(path, overrides or {}), hooks=hooks)
    shadowed = shadowed_in(program.blocks)
    runner = Runner(program, RunOptions(duration=seconds, speed=speed, warn=told.append))
    if record is not None:
        record.attach(runner)
    report = runner.run()
    arrays = {name: np.array(values) for name, values in rows.items()}
    return Ran(report, shadowed, arrays, answers, told)  # type: ignore[arg-type]
