"""One workflow in MuJoCo, run again and again with other contracts of its policy.

The workflow is built once; between two runs only the tick of its policy block is exchanged, so
everything else is the graph that would be deployed.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from unicon_core.check.model_facts import joint_depths, joint_ids
from unicon_core.check.twin.measures import Measures, Recorder
from unicon_core.errors import Fault, UniconError
from unicon_core.flow import Block
from unicon_core.policies import Policy, PolicyContract
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Workflow
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.workflow import build_workflow

__all__ = ["TwinSession"]

_LONGEST = 60.0  # [s] of simulated time, for flows that do something before the policy
_WALK = 0.6  # [m/s] commanded where neither workflow nor contract says anything
_SLOW = 0.5  # [m/s]; at 0.3 m/s standing still tracks with 0.70 and tells nothing


def _reads_command(contract: PolicyContract) -> bool:
    """Whether a policy is to follow a velocity command."""
    named = (*contract.inputs, *(term.state for term in contract.terms))
    return "velocity_command" in named


class _Counted:
    """The tick of a policy block, with the number of its calls."""

    def __init__(self, policy: Policy) -> None:
        self.policy, self.calls = policy, 0

    def __call__(self) -> None:
        self.calls += 1
        self.policy()


class TwinSession:
    """Runs of one workflow on the platform `mujoco`, one robot.

    Args:
        document: the workflow, already on that platform.
        command: vx, vy [m/s], wz [rad/s]. None takes the workflow's own where it walks at 0.5 m/s
            or more, else 0.6 of the trained forward speed: broken contracts stand and creep too.

    Attributes:
        called: keys of the policies that ran in the last run.

    Raises:
        UniconError: the workflow cannot be built.
    """

    def __init__(self, document: WorkflowDocument, command: Sequence[float] | None = None) -> None:
        self._command = command
        self.called: frozenset[str] = frozenset()
        self.workflow = build_workflow(document, inputs=[self._commander])
        keys = {id(contract): key for key, contract in self.workflow.policies.items()}
        self._uses = [
            (keys[id(block.tick.contract)], block, block.tick)
            for block in self.workflow.blocks
            if isinstance(block.tick, Policy)
        ]
        info = self.workflow.platform.info()
        self._effort = np.array(list(info["effort_upper"].values()))

    @property
    def contracts(self) -> dict[str, PolicyContract]:
        """Key under `policies:` to contract, of the policies in the flow."""
        return {key: policy.contract for key, _, policy in self._uses}

    def depths(self, joints: Sequence[str]) -> list[int]:
        """Return how many joints are above each joint in the model, shape (n,)."""
        platform: Any = self.workflow.platform
        depths = joint_depths(platform.model, self.workflow.robot.joint_names)
        return [depths[name] for name in joints]

    def poses(self) -> dict[str, dict[str, float]]:
        """Return default poses that somebody else names: the robot file's and key frames'."""
        platform: Any = self.workflow.platform
        model, robot = platform.model, self.workflow.robot
        found = {
            "the robot file's default pose": dict(
                zip(robot.joint_names, map(float, robot.default_joint_pos))
            )
        }
        addresses = [int(model.jnt_qposadr[j]) for j in joint_ids(model, robot.joint_names)]
        for i in range(model.nkey):
            name = f"the pose of the model's key frame {model.key(i).name!r}"
            found[name] = dict(zip(robot.joint_names, map(float, model.key_qpos[i][addresses])))
        return found

    def run(
        self,
        seconds: float,
        key: str = "",
        contract: PolicyContract | None = None,
        *,
        unlimited: bool = False,
    ) -> Measures:
        """Run from the beginning.

        Args:
            seconds: of simulated time from the policy's first call; a flow without policy runs
                to its end.
            key: a policy under `policies:` whose contract is exchanged.
            contract: in place of the given one.
            unlimited: without limits of effort.
        """
        workflow = self.workflow
        counted = self._exchange(key, contract)
        workflow.states.reset()
        runner = Runner(workflow, RunOptions(speed="max", warn=lambda text: None))
        runner.reset()
        recorder = Recorder(workflow.states, workflow.robot, self._effort, workflow.period)
        longest, walked = round(_LONGEST / workflow.period), round(seconds / workflow.period)
        fault, begun = "", 0
        limits = self._lift_limits() if unlimited else None
        try:
            # A broken contract may well send numbers of any size.
            with np.errstate(over="ignore", invalid="ignore"):
                while len(recorder.rows) < longest and not runner.tick(0):
                    begun += any(tick.calls for tick in counted.values())
                    if recorder(begun > 0) or (counted and begun >= walked):
                        break
        except Fault as error:
            fault = str(error)
        finally:
            self._restore()
            if limits is not None:
                self._set_limits(*limits)
            self.called = frozenset(name for name, tick in counted.items() if tick.calls)
        ticks = len(recorder.rows)
        asked = (ticks - begun + walked if counted else max(ticks, 1)) * workflow.period
        tracks = any(_reads_command(contract) for contract in self.contracts.values())
        return recorder.measures(asked, fault, tracks)

    def close(self) -> None:
        """Close the workflow; how a simulator ends does not matter."""
        with suppress(UniconError):
            self.workflow.close()

    def _commander(self, workflow: Workflow) -> list[Block]:
        """Return the block that commands a walk, as /cmd_vel would."""
        contracts = workflow.policies.values()
        if not any(_reads_command(contract) for contract in contracts):
            return []
        ranges = [contract.command_ranges for contract in contracts]
        fastest = [found["lin_vel_x"][1] for found in ranges if "lin_vel_x" in found]
        walk = (min(0.6 * fastest[0], 1.0) if fastest else _WALK, 0.0, 0.0)
        wanted = np.array(self._command or walk, np.float32)
        always = self._command is not None
        command = workflow.states["velocity_command"]

        def twin_command() -> None:
            if always or float(np.hypot(command[0], command[1])) < _SLOW:
                command[...] = wanted

        return [Block("twin_command", twin_command, amends=("velocity_command",), endless=True)]

    def _exchange(self, key: str, contract: PolicyContract | None) -> dict[str, _Counted]:
        workflow = self.workflow
        counted: dict[str, _Counted] = {}
        for used, block, policy in self._uses:
            running = policy
            if contract is not None and used == key:
                running = Policy(
                    contract,
                    workflow.states,
                    workflow.robot,
                    prefix=f"{key}_" if len(workflow.policies) > 1 else "",
                    network=policy.network,
                )
            tick = counted.setdefault(used, _Counted(running))
            block.tick, block.reset, block.warm_up = tick, running.reset, None
        return counted

    def _restore(self) -> None:
        for _, block, policy in self._uses:
            block.tick, block.reset, block.warm_up = policy, policy.reset, policy.warm_up

    def _lift_limits(self) -> tuple[Any, Any]:
        model: Any = self.workflow.platform.model  # type: ignore[attr-defined]
        before = np.array(model.actuator_forcelimited), np.array(model.jnt_actfrclimited)
        self._set_limits(0, 0)
        return before

    def _set_limits(self, actuators: Any, joints: Any) -> None:
        model: Any = self.workflow.platform.model  # type: ignore[attr-defined]
        model.actuator_forcelimited[:] = actuators
        model.jnt_actfrclimited[:] = joints
