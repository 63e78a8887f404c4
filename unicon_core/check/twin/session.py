"""One workflow in MuJoCo, run again and again with other contracts of its policy.

The workflow is built once; between two runs only the tick of its policy block is exchanged, so
everything else is the graph that would be deployed.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, cast

import numpy as np

from unicon_core.check.model_facts import joint_depths
from unicon_core.check.twin.measures import Measures, Recorder
from unicon_core.errors import Fault, UniconError
from unicon_core.flow import Block
from unicon_core.policies import OnnxPolicy, PolicyContract
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Workflow
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.workflow import build_workflow

__all__ = ["TwinSession"]

_LONGEST = 60.0  # [s] of simulated time, for flows that do something before the policy
_WALK = 0.5  # [m/s] commanded where neither workflow nor contract says anything


class _Counted:
    """The tick of a policy block, with the number of its calls."""

    def __init__(self, policy: OnnxPolicy) -> None:
        self.policy, self.calls = policy, 0

    def __call__(self) -> None:
        self.calls += 1
        self.policy()


class TwinSession:
    """Runs of one workflow on the platform `mujoco`, one robot.

    Args:
        document: the workflow, already on that platform.
        command: vx, vy [m/s], wz [rad/s] while the workflow itself commands nothing; None takes
            half the trained forward speed.

    Raises:
        UniconError: the workflow cannot be built.
    """

    def __init__(self, document: WorkflowDocument, command: Sequence[float] | None = None) -> None:
        self._command = command
        self.workflow = build_workflow(document, inputs=[self._commander])
        self._blocks: dict[str, Block] = {}
        for block in self.workflow.blocks:
            if isinstance(block.tick, OnnxPolicy):
                self._blocks.setdefault(block.tick.name, block)
        self._policies = {
            name: cast(OnnxPolicy, block.tick) for name, block in self._blocks.items()
        }
        info = self.workflow.platform.info()
        self._effort = np.array(list(info["effort_upper"].values()))

    @property
    def contracts(self) -> list[PolicyContract]:
        """Contracts of the policies that the flow uses."""
        return [policy.contract for policy in self._policies.values()]

    def depths(self, joints: Sequence[str]) -> list[int]:
        """Return how many joints are above each joint in the model, shape (n,)."""
        platform: Any = self.workflow.platform
        depths = joint_depths(platform.model, self.workflow.robot.joint_names)
        return [depths[name] for name in joints]

    def run(
        self, seconds: float, contract: PolicyContract | None = None, *, unlimited: bool = False
    ) -> Measures:
        """Run from the beginning.

        Args:
            seconds: of simulated time from the policy's first call; a flow without policy runs
                to its end.
            contract: in place of the given one, for the policy of its name.
            unlimited: without limits of effort.
        """
        workflow = self.workflow
        counted = self._exchange(contract)
        workflow.states.reset()
        runner = Runner(workflow, RunOptions(speed="max", warn=lambda text: None))
        runner.reset()
        recorder = Recorder(workflow.states, workflow.robot, self._effort, workflow.period)
        longest, walked = round(_LONGEST / workflow.period), round(seconds / workflow.period)
        fault, begun = "", 0
        limits = self._lift_limits() if unlimited else None
        try:
            while len(recorder.rows) < longest and not runner.tick(0):
                begun += any(tick.calls for tick in counted)
                if recorder() or (counted and begun >= walked):
                    break
        except Fault as error:
            fault = str(error)
        finally:
            self._restore()
            if limits is not None:
                self._set_limits(*limits)
        ticks = len(recorder.rows)
        asked = (ticks - begun + walked if counted else max(ticks, 1)) * workflow.period
        tracks = any(term.state == "velocity_command" for c in self.contracts for term in c.terms)
        return recorder.measures(asked, fault, tracks)

    def close(self) -> None:
        """Close the workflow; how a simulator ends does not matter."""
        with suppress(UniconError):
            self.workflow.close()

    def _commander(self, workflow: Workflow) -> list[Block]:
        """Return the block that commands a walk while nobody else commands anything."""
        ranges = [contract.command_ranges for contract in workflow.policies.values()]
        fastest = [found["lin_vel_x"][1] for found in ranges if "lin_vel_x" in found]
        walk = (min(0.5 * fastest[0], 0.6) if fastest else _WALK, 0.0, 0.0)
        wanted = np.array(self._command or walk, np.float32)
        command = workflow.states["velocity_command"]

        def twin_command() -> None:
            if not command.any():
                command[...] = wanted

        return [Block("twin_command", twin_command, amends=("velocity_command",), endless=True)]

    def _exchange(self, contract: PolicyContract | None) -> list[_Counted]:
        counted = []
        for name, block in self._blocks.items():
            policy = self._policies[name]
            if contract is not None and contract.name == name:
                workflow = self.workflow
                policy = OnnxPolicy(
                    contract, workflow.states, workflow.robot, network=policy.network
                )
            tick = _Counted(policy)
            block.tick, block.reset, block.dry_run = tick, policy.reset, None
            counted.append(tick)
        return counted

    def _restore(self) -> None:
        for name, block in self._blocks.items():
            policy = self._policies[name]
            block.tick, block.reset, block.dry_run = policy, policy.reset, policy.dry_run

    def _lift_limits(self) -> tuple[Any, Any]:
        model: Any = self.workflow.platform.model  # type: ignore[attr-defined]
        before = np.array(model.actuator_forcelimited), np.array(model.jnt_actfrclimited)
        self._set_limits(0, 0)
        return before

    def _set_limits(self, actuators: Any, joints: Any) -> None:
        model: Any = self.workflow.platform.model  # type: ignore[attr-defined]
        model.actuator_forcelimited[:] = actuators
        model.jnt_actfrclimited[:] = joints
