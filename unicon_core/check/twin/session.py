"""One workflow on a simulator, run again and again with other contracts of its policy.

The workflow is built once; between two runs only the tick of its policy block is exchanged, so
everything else is the graph that would be deployed.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from copy import deepcopy
from dataclasses import replace

import numpy as np

from unicon_base import Fault, PlatformError, UniconError
from unicon_base.arrays import Array, Float32, Float64
from unicon_core.blocks.approach import Monitor
from unicon_core.check.twin.measures import Measures
from unicon_core.check.twin.perturb import AS_GIVEN, Change
from unicon_core.flow import Block, Stage
from unicon_core.models.find import model_of
from unicon_core.models.load import load_model
from unicon_core.platforms.platform import info_of
from unicon_core.policies import Policy, PolicyContract
from unicon_core.policies.controller import prefix_of
from unicon_core.policies.policy import DrivenPolicy
from unicon_core.robots import Robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States
from unicon_core.workflow import HookBlocks, Program, WorkflowDocument

JUDGED = (
    "joint_pos", "joint_effort", "base_ang_vel", "base_lin_vel", "base_pos_w", "projected_gravity"
)  # fmt: skip
"""States of a simulator by which a run is judged."""

ROW = ("joint_pos", "joint_effort", "joint_pos_target", "velocity_command")
"""States that are kept of every tick, beside the velocity of the base."""

TRACKING_SIGMA = 0.25
"""Width of the tracking kernel in [m²/s²]."""
MOTION_SIGMA = 0.0625
"""Width of the kernel of a motion in [rad²]: 0.25 rad from the reference in all joints is far."""
SMOOTH_RATE = 15.0
"""Rate of targets in [rad/s] at which smoothness has fallen to 1/e."""
START = 1.0
"""Time from rest that tracking leaves out in [s]."""
AT_LIMIT = 0.005
"""A joint within this distance of its limit in [rad] is at the limit."""


class TwinBlindError(UniconError):
    """There is no base whose motion tells how well a contract does."""


_LONGEST = 60.0  # [s] of simulated time, for flows that do something before the policy
_WALK = 0.6  # [m/s] commanded where neither workflow nor contract says anything
_CURVE = 0.3  # [rad/s]
_SLOW = 0.5  # [m/s]; at 0.3 m/s standing still tracks with 0.70 and tells nothing


def _reads_command(contract: PolicyContract) -> bool:
    """Whether a policy is to follow a velocity command."""
    return "velocity_command" in contract.seen


def _ranges(program: Program) -> Mapping[str, tuple[float, float]]:
    """Return for which commands policies were trained; of several the first that says so."""
    return ChainMap(*(dict(contract.command_ranges) for contract in program.policies.values()))


class _Counted:
    """The tick of a policy block, with the number of its calls."""

    def __init__(self, policy: Policy | DrivenPolicy) -> None:
        self.policy, self.calls = policy, 0

    def __call__(self) -> bool:
        self.calls += 1
        return self.policy()


class Recorder:
    """Looks at the states after each tick.

    Args:
        states: of the workflow.
        robot: limits and names.
        effort: torque limits in use in [N·m], shape (n,), infinite for none.
        period: of a tick in [s].
        motion_error: of a policy that follows a motion, joints first, in [rad], read in place.
    """

    def __init__(
        self,
        states: States,
        robot: Robot,
        effort: Float64,
        period: float,
        motion_error: Array | None = None,
    ) -> None:
        self._robot, self._period = robot, period
        names = {*JUDGED, *ROW}
        self._views = {name: states[name].reshape(-1, states.spec(name).size)[0] for name in names}
        self._effort = effort
        self._motion = None if motion_error is None else motion_error.reshape(-1, 2)[0, :1]
        self._standing: float | None = None
        self.fell = False
        self.rows: list[list[Float64]] = []

    def __call__(self, walking: bool) -> bool:
        """Note the tick; True once the base has fallen.

        Args:
            walking: a policy has taken over; before, the flow may lie down as it likes, and what it
                did is forgotten then.
        """
        views = self._views
        height = float(views["base_pos_w"][2])
        if walking and self._standing is None:
            self.rows.clear()
            self._standing = height
        velocity = np.array([*views["base_lin_vel"][:2], views["base_ang_vel"][2]])
        motion = np.zeros(1) if self._motion is None else self._motion
        row = (*(views[name] for name in ROW), velocity, motion)
        self.rows.append([values.astype(np.float64) for values in row])
        tilted = float(views["projected_gravity"][2]) > -Monitor.FALL_COSINE
        # Below a share of its height when the policy took over.
        sunk = self._standing is not None and height < Monitor.FALL_HEIGHT * self._standing
        self.fell = tilted or sunk
        return self.fell

    def measures(self, asked_s: float, fault: str, tracks: bool) -> Measures:
        """Return what was seen.

        Args:
            asked_s: how long the run should have lasted in [s].
            fault: what stopped it, or "".
            tracks: whether following the command counts.
        """
        if not self.rows:
            return Measures(asked_s, fault)
        robot, period, names = self._robot, self._period, self._robot.joint_names
        pos, effort, target, command, velocity, motion = map(np.stack, zip(*self.rows))
        survived = len(self.rows) * period
        begin = min(round(START / period), len(self.rows) - 1)
        squared = ((velocity - command)[begin:] ** 2).sum(axis=1)
        off = None if tracks or self._motion is None else motion[begin:, 0]
        kernel = squared / TRACKING_SIGMA if off is None else off**2 / MOTION_SIGMA
        rates = np.diff(target[:, ~robot.endless], axis=0) / period
        steps = rates.any(axis=1).mean()  # between them a slower policy's targets are held
        rate = float(np.sqrt((rates**2).mean() * steps)) if rates.size else 0.0
        use = np.sqrt((effort**2).mean(axis=0)) / self._effort
        hits = ((pos <= robot.lower + AT_LIMIT) | (pos >= robot.upper - AT_LIMIT)).mean(axis=0)
        saturated = (np.abs(effort) >= 0.999 * self._effort).mean(axis=0)
        worst, longest = int(use.argmax()), int(saturated.argmax())
        return Measures(
            asked_s,
            fault,
            survived_s=survived,
            fell=self.fell,
            velocity_error=float(np.sqrt(squared).mean()),
            velocity=velocity.mean(axis=0).tolist(),
            command=command.mean(axis=0).tolist(),
            target_rate=rate,
            torque_use=float(use[worst]),
            torque_joint=names[worst],
            saturated=float(saturated.mean()),
            saturated_joint=names[longest],
            saturated_share=float(saturated[longest]),
            limit_hits={names[i]: float(hits[i]) for i in np.argsort(-hits) if hits[i]},
            tracking=float(np.exp(-kernel).mean()),
            smoothness=float(np.exp(-((rate / SMOOTH_RATE) ** 2))),
            survival=min(1.0, survived / asked_s) if self.fell or fault else 1.0,
            tracks=tracks,
            motion_error=None if off is None else float(off.mean()),
        )


class TwinSession:
    """Runs of one workflow on a simulator, one robot.

    Args:
        document: the program, already on that simulator.
        command: vx, vy [m/s], wz [rad/s]. None takes the workflow's own where it walks at 0.5 m/s
            or more, else 0.6 of the trained forward speed: broken contracts stand and creep too.
        contracts: policies by their key, in place of those of the document.

    Attributes:
        model: of the robot, as its file has it.
        called: keys of the policies that ran in the last run.
        passive_damping: of the joints themselves in [N·m·s/rad], shape (n,), 0 where it is not
            told or cannot be left out.

    Raises:
        UniconError: the workflow cannot be built, or its simulator does not tell enough.
    """

    def __init__(
        self,
        document: WorkflowDocument,
        command: Sequence[float] | None = None,
        contracts: Mapping[str, PolicyContract] | None = None,
    ) -> None:
        self.document = document
        self._command = command
        self._others: dict[float, TwinSession] = {}
        self._wanted: Float64 | None = None
        self._asked: Float32 | None = None
        self.called: frozenset[str] = frozenset()
        alone = replace(document, values=document.values | {"shadow": None})  # it moves nothing
        self.program = Program(alone, hooks=[self._commander], contracts=contracts)
        keys = {id(contract): key for key, contract in self.program.policies.items()}
        self._uses = [
            (keys[id(block.tick.contract)], block, block.tick)
            for block in self.program.blocks
            if isinstance(block.tick, Policy | DrivenPolicy)
        ]
        robot, platform = self.program.robot, self.program.platform
        own = getattr(platform, "passive_damping", np.zeros(robot.num_joints))
        self.passive_damping = np.asarray(own, np.float64)
        try:
            untold = [name for name in JUDGED if name not in platform.facts.writes]
            if untold and not robot.floats:
                raise TwinBlindError(
                    f"the base of robot {robot.name} is fixed: nothing was simulated, since the "
                    f"twin judges by {', '.join(untold)}"
                )
            if untold:
                raise PlatformError(
                    f"platform {platform.facts.name!r} does not tell {', '.join(untold)}, by which "
                    "the twin judges; leave --twin out"
                )
            self.model = load_model(model_of(platform, robot), robot, quiet=True)
        except BaseException:
            self.close()
            raise
        limits = info_of(platform).get("effort_upper", {}).values()  # the model's, where tighter
        self._effort = np.array(list(limits) or np.nan_to_num(robot.effort_limit, nan=np.inf))

    @property
    def contracts(self) -> dict[str, PolicyContract]:
        """Key under `policies:` to contract, of the policies in the flow."""
        return {key: policy.contract for key, _, policy in self._uses}

    def can(self, change: Change) -> bool:
        """Whether the simulator can do for a while without what a change takes away.

        A platform says so by methods that return the while: `unlimited()`, without its limits of
        effort; `undamped()`, without the damping of the joints themselves, which
        `passive_damping` gives in [N·m·s/rad], shape (n,); `locked(joints)`, with joints held, by
        their place in the robot, as if they were welded.
        """
        if change.without == "undamped" and not self.passive_damping.any():
            return False
        return not change.without or hasattr(self.program.platform, change.without)

    def run(
        self,
        seconds: float,
        key: str = "",
        change: Change = AS_GIVEN,
        command: Sequence[float] | None = None,
    ) -> Measures:
        """Run from the beginning.

        Args:
            seconds: of simulated time from the policy's first call; a flow without policy runs
                to its end.
            key: a policy under `policies:` whose contract is exchanged.
            change: its contract in place of the given one, and what is to be otherwise in the
                simulator, where that can do so. With another period it runs in a session of its
                own.
            command: vx, vy [m/s], wz [rad/s] in place of the session's.

        Raises:
            UniconError: the simulator's step does not divide another period.
        """
        contract = change.contract
        if contract is not None and contract.period != self.program.policies[key].period:
            if contract.period not in self._others:
                values = deepcopy(self.document.values)
                values["rate"] = 1.0 / min(self.program.period, contract.period)
                document = replace(self.document, values=values)
                self._others[contract.period] = TwinSession(
                    document, self._command, {key: contract}
                )
            return self._others[contract.period].run(seconds, key, change, command)
        program, platform = self.program, self.program.platform
        self._asked = None if command is None else np.array(command, np.float32)
        counted = self._exchange(key, contract)
        runner = Runner(program, RunOptions(speed="max", warn=lambda text: None))
        recorder = Recorder(
            program.states, program.robot, self._effort, program.period, self._motion_error()
        )
        longest, walked = round(_LONGEST / program.period), round(seconds / program.period)
        fault, begun = "", 0
        changed = nullcontext()
        if change.without and self.can(change):
            joints = [*map(program.robot.joint_names.index, change.locked)]
            changed = getattr(platform, change.without)(*[joints] if joints else ())
        try:
            # A broken contract may well send numbers of any size.
            with changed, np.errstate(over="ignore", invalid="ignore"):
                program.states.reset()
                runner.reset()
                while len(recorder.rows) < longest and not runner.tick(0):
                    begun += any(tick.calls for tick in counted.values())
                    if recorder(begun > 0) or (counted and begun >= walked):
                        break
        except Fault as error:
            fault = str(error)
        self.called = frozenset(name for name, tick in counted.items() if tick.calls)
        ticks = len(recorder.rows)
        asked = (ticks - begun + walked if counted else max(ticks, 1)) * program.period
        tracks = any(map(_reads_command, self.contracts.values()))
        return recorder.measures(asked, fault, tracks)

    def walks(self) -> list[list[float] | None]:
        """Return commands for comparing contracts: that of the session, faster, slower, in curves.

        They are near to it: a policy may stand still when less is commanded, whatever its contract.
        Where nothing is commanded it is None alone.
        """
        if self._wanted is None or not self._wanted.any():
            return [None if self._wanted is None else self._wanted.tolist()]
        walks = [self._wanted * factor for factor in (1.0, 0.85, 1.15)]
        if any(_ranges(self.program).get("ang_vel_z", (1.0,))):
            walks += [self._wanted + np.array((0.0, 0.0, turn)) for turn in (-_CURVE, _CURVE)]
        return [walk.tolist() for walk in walks]

    def close(self) -> None:
        """Close the workflow; how a simulator ends does not matter."""
        for session in (self, *self._others.values()):
            with suppress(UniconError):
                session.program.close()

    def _motion_error(self) -> Float32 | None:
        """Return the state of the first policy that follows a motion."""
        policies, states = self.program.policies, self.program.states
        names = (f"{prefix_of(key, policies)}motion_error" for key in self.contracts)
        return next((states[name] for name in names if name in states), None)

    def _commander(self, program: Program) -> HookBlocks:
        """Return the block that commands a walk, as /cmd_vel would."""
        if not any(map(_reads_command, program.policies.values())):
            return {}
        _, fastest = _ranges(program).get("lin_vel_x", (0.0, 0.0))
        walk = (min(0.6 * fastest, 1.0) if fastest else _WALK, 0.0, 0.0)
        self._wanted = wanted = np.array(self._command or walk, np.float64)
        always = self._command is not None
        command = program.states["velocity_command"]

        def twin_command() -> None:
            if self._asked is not None:
                command[...] = self._asked
            elif always or float(np.hypot(command[0], command[1])) < _SLOW:
                command[...] = wanted

        block = Block("twin_command", twin_command, amends=("velocity_command",), endless=True)
        return {Stage.INPUT: [block]}

    def _exchange(self, key: str, contract: PolicyContract | None) -> dict[str, _Counted]:
        counted: dict[str, _Counted] = {}
        for used, block, policy in self._uses:
            running = policy if contract is None or used != key else policy.like(contract)
            tick = counted.setdefault(used, _Counted(running))
            block.tick, block.reset, block.warm_up = tick, running.reset, None
        return counted
