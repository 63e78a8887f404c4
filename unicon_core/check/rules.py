"""Rules of `unicon check`, gates and `unicon preflight`: code, what it looks at, why, and a remedy.

`unicon explain CODE` prints one, docs/reference/rules.md all. What explains other findings stands
first: an order of joints that is wrong, for example, also gives poses outside the limits, different
sides and feet in the air.
"""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Rule:
    """One thing that may be wrong.

    Attributes:
        code: names it, for `accept`, `--force` and `unicon explain`.
        kind: `error` fails the check, `note` does not; `either`, by what is seen; `firm`: an error
            with which a run cannot begin: nobody can accept it or force it.
        needs: what it looks at, beside the workflow: document, robot, policy, model, platform,
            rollout, or `live`, the data of the running robot, which gates and `unicon preflight`
            have; with commas.
        what: is wrong, in one line.
        why: it matters.
        remedy: what to do about it.
    """

    code: str
    kind: str
    needs: str
    what: str
    why: str
    remedy: str

    @property
    def firm(self) -> bool:
        """Whether a run cannot begin with it."""
        return self.kind == "firm"

    def text(self) -> str:
        """Return the rule for a terminal."""
        kinds = {
            "firm": "error, cannot be accepted or forced",
            "either": "error or note, by what is seen",
        }
        return (
            f"{self.code}: {self.what}\n  kind    {kinds.get(self.kind, self.kind)}\n"
            f"  looks at {self.needs}\n  why     {self.why}\n  remedy  {self.remedy}"
        )


# Code, kind and what it looks at; what is wrong, why it matters, remedy.
TABLE = """\
check.settings firm: document
  the workflow's `check:` section is wrong
  a misspelt code accepts nothing
  correct the key or the code; `unicon explain` lists the codes
build firm: document, robot, policy, platform
  the workflow cannot be built
  a run would be refused by the same error
  mend what the line names
graph firm: document
  the graph of blocks is wrong
  a block would read what nothing has written yet, or two would write one state
  move the block, or give one of them another state
robot.facts firm: robot, platform
  the robot file lacks what is needed to drive the robot
  without motor order, limits, gains or protocol, commands are guesses; a note in simulation
  find them (the vendor's URDF, SDK or a measurement) and add them with their source
parts.writers firm: document
  two parts of a divided workflow write one state
  the last value that arrives would win
  give one of them a state of its own (states: in the block's options)
parts.published firm: document
  a state does not reach the part that reads it, or nothing writes it
  the part would read its initial value for ever
  name it under `publishes` of the part that writes it
parts.silent firm: document
  no command is defined for when the commanding part is silent
  a pulled cable would leave the last command standing
  write silent: {then: fault} or {then: hold}, or the values under set:
joints.motors error: robot
  motor slots do not fit the joints
  commands would go to other motors
  list one slot a joint in transport.motors, in the order of joints
joints.order error: policy, robot
  joints and figures have different orders
  gains, scales and pose would be at the wrong joints
  give the joints in the order in which the policy was trained
model.collision error: model
  the robot's model does not collide with the floor
  it falls through; often mesh files are absent
  add the mesh files, or give the feet geoms contype and conaffinity or a <pair>
limits.effort error: robot, model
  effort limits of robot file and model are far apart
  one is another robot's, or in another unit
  correct joints.effort, or choose the model of this robot
gains.swapped error: policy
  damping is greater than stiffness at most joints
  the joints hardly hold
  exchange stiffness and damping
gains.damping either: policy, model
  a joint has stiffness but no damping
  it swings; some exporters write 0 for servos that damp themselves
  give the damping of the training
pose.limits error: policy, robot
  the default pose is outside the limits
  an action of 0 would press against a stop
  correct the pose, its order or its unit (degrees?), or the limits
pose.symmetry error: policy, robot
  the default pose is not the same on both sides
  a sign or the joint order is wrong
  correct the pose, or accept it where it is meant
timing.period error: policy
  the control period is not plausible
  the policy would run at another rate than in training
  give the control period in [s], decimation × physics step: 0.02 for 50 Hz
timing.clock error: policy
  a phase or the period of the gait clock is in another unit
  the gait would be far too fast or slow
  give phases in [rad], and the period of the gait in [s]: 0.8 for 1.25 Hz
observation.frame error: platform
  the platform's orientation and gravity contradict each other
  the policy would see a tilt
  deliver base_quat as w, x, y, z of length 1, base to world
observation.scale either: policy
  a term is multiplied by 0, or by an odd factor
  the policy is blind for it, or sees another unit
  give the scale of the training, or leave the term out
observation.clip error: policy
  a term is clipped to a single value
  the policy would always see the same
  give [lowest, highest], or leave the clip out
observation.measured error: policy, platform
  a term cannot be measured on this platform
  the policy would act on its initial value
  add an estimator under `estimate:`, or a platform that measures it
action.limp error: policy
  a joint is given positions and has no stiffness
  it does not go there
  give action.kind velocity or torque there, or the stiffness of the training
action.scale either: policy, robot
  one unit of action is more than a joint's range, or nothing
  degrees for radians, or a scale of another policy
  give the scale of the training in [rad]
gains.symmetry error: policy
  left and right joints have different gains
  the joint order or a figure is wrong
  correct the gains, or accept it where it is meant
action.symmetry error: policy
  left and right joints have different action scales
  the joint order or a figure is wrong
  correct the scales, or accept it where it is meant
action.offset error: policy, robot
  action 0 means a target outside the limits
  the joint would press against its stop
  correct the offset (the default pose) or the robot's limits
gains.stiff error: policy, robot, model
  a joint is at its effort limit within a tenth of a radian, or by its damping
  the servo is on or off, and shakes
  correct stiffness and damping, or joints.effort in the robot file
pose.feet either: policy, model
  in the default pose the robot does not stand on its feet
  the pose, its joint order or a sign is wrong
  correct the pose, its order, signs or unit
blocks.memory note: document
  a block remembers what it does not declare
  a replay and a snapshot would lack it
  name the attributes in one line of its class: memory = (…)
joints.held note: policy, robot
  joints that no policy moves
  they keep the robot file's pose and gains
  nothing, where that is meant
joints.welded note: policy, model
  the simulated model lacks joints that no policy moves
  they are fixed in simulation alone
  nothing, or choose a model with all joints
joints.seen error: policy
  a policy sees joints that other blocks move
  it sees motions unlike those in training
  hide them: sees_default_for: [GROUP]; accept it where the policy was trained so
evidence note: platform, robot
  platform or robot were hardly run against anything real
  surprises on the robot are likely
  begin as docs/howto/preflight.md says
gains.differ note: policy, robot
  the policy's gains are not the robot file's
  the policy's are used
  nothing, where the policy was trained with them
gains.passive note: policy, model
  the model's joints damp themselves as much as the policy does
  in simulation both act, on the robot only the policy's
  passive: replace, where the model's damping is the servos'
limits.differ note: robot, model
  robot file and model have other limits
  targets are kept within the robot's, the smaller efforts are simulated
  correct the one that is wrong
action.reach error: policy, robot
  clipped actions reach outside the limits, and nothing limits targets
  a large action would be sent as it is
  add joint_limits to safety, or a clip
action.unsent error: policy, platform
  the platform does not send commanded velocities or torques
  part of the command would be lost
  choose a map or platform that sends them, or leave them out
action.torque note: policy, robot
  one unit of action asks for more torque than there is
  joints at their limit lead to a fall
  compare scale and stiffness with the training's
timing.catch_up firm: document, platform
  missed ticks shall be caught up on a robot
  several commands in a row would be of old data
  set pacing.overrun: skip
timing.trigger firm: document, platform
  ticks shall wait for data of a platform that cannot tell when they arrive
  no tick would come
  set pacing.trigger: deadline
command.range error: document, policy
  the workflow commands more than the policy was trained for
  the policy falls or shakes there
  keep the command within command_ranges
command.bounds note: policy, robot
  nobody says how much may be commanded
  a remote's full stick is the only bound
  give command_ranges in the policy or the robot file
policy.source note: policy
  what was read of a policy, and from where, or left open
  an exporter's facts may be ambiguous
  look through them once
pose.differ note: policy, robot
  the policy's default pose is not the robot file's
  the policy's is used
  nothing, where the policy was trained with it
pose.floor error: document, model
  the simulation begins inside the floor or far above it
  the first steps throw the robot up or drop it
  leave scene.initial_height out, or correct it
scene.ground note: document, platform
  the platform does not lay the scene's terrain
  the robot stands on the world's ground
  nothing, or platform: mujoco
pose.start either: document, policy
  a policy is the first to move a robot that lies
  policies are trained from standing
  let `pose: {to: stand}` go there first: flow: {chain: [{pose: …}, {policy: …}]}
start.gates note: document
  nothing is asked before a robot moves
  a fall would reveal a wrong posture or a silent sensor
  leave start.gates out
start.watchdog note: platform
  nothing damps a robot whose process is killed
  motors keep the last command
  use a protocol with a command timeout, or be ready with the remote
safety.none note: document
  no safety block looks at commands
  every command is sent as it is
  leave `safety` out, or list blocks
safety.less note: document
  a robot lacks safety blocks that others have
  what they would find is found by the robot
  leave `only` out of safety
safety.remote either: document, robot
  buttons that stop the robot have another meaning as well
  pressing them would do two things
  choose other buttons in one of the two places
safety.partial error: document
  a safety block does not look at every command, or at nothing
  a command would pass it
  write it into safety: by itself, correct its states:, or take it out
zmq.keys error: document
  without keys everybody on the network may read or write states
  a stranger's frame could move the robot
  make keys (docs/howto/zmq.md) and name their folder
platform.open note: platform
  what only the opened platform can tell
  the check does not open it
  unicon preflight looks
model.meshes note: model
  mesh files of the model are absent
  it is simulated without them
  fetch the files that the note names
model.bodies note: model, robot
  the model lacks a body that the robot file names
  blocks that use it are refused
  correct the name, or choose the model
reach.apart note: document, robot
  capsules that are near at the default pose are not kept apart
  they would push each other away at once
  make them smaller, or nothing
map.fit firm: document
  the message map does not fit the states, or cannot be read
  a topic would be missing, or refused
  correct the entry that the finding names
twin.run error: rollout
  the twin could not be run
  nothing is known of what the policy does
  mend what the line names
twin.platform note: rollout
  the twin runs on another platform than the workflow's
  a robot is not simulated by its own platform
  nothing
twin.fall error: rollout
  the policy falls in the twin
  it would fall on the robot
  compare what it names with the training side, after the findings before it
twin.command error: rollout
  the policy does not follow its command, or its motion, in the twin
  a scale, an order or a frame is wrong
  compare what it names with the training side, after the findings before it
twin.suspect either: rollout
  another contract does clearly better
  the twin undid a usual mistake
  compare what it names with the training side
twin.saturated error: rollout
  a joint is at its limit of effort or position for much of the walk
  gains, period or limits are not those of the training
  compare default pose, gains, period, action.scale and limits with the training side, and the \
effort limit with the motor's
gate.data firm: live
  a state that the command depends on has not arrived, or is not finite
  the policy would begin on initial values
  turn the platform's source on; correct the map or the driver
gate.rate firm: live
  new data come less often than the robot file promises
  the policy would act on old data
  send more often, look for losses on the way, or lower `rate:`
gate.changing firm: live
  a sensor repeats the same bytes while others have noise
  it is frozen or not connected
  restart the robot's driver
gate.imu firm: live
  orientation, gravity, accelerometer and gyroscope contradict each other at rest
  the policy falls at once
  hold the robot still; correct the IMU's axes, signs and units in the driver or the map
gate.posture firm: live
  a joint is measured outside its limits
  an encoder is off, or it is another robot's file
  move the joint by hand, calibrate its encoder, or correct the limits
gate.tilt firm: live
  the base leans more than the run allows
  the run would end in its first tick
  set the robot upright, or correct the IMU's axes
gate.stop firm: live
  a safety block of the workflow would trip
  the run would end in its first tick
  mend what the block names
gate.variant firm: live
  the robot reports another variant than the robot file describes
  limits, gains and joints may be others
  choose the robot file of this variant
gate.commanders firm: live
  another program sends commands to the robot
  two controllers would pull at the same motors
  end the other program, or the robot's own controller
gate.command firm: live
  the velocity command is not zero
  the robot would walk away at its first step
  let go of the stick, or stop the program that publishes the command
preflight.frames firm: live
  the robot sends fewer than half of the promised frames
  the robot is in another mode, or the network loses frames
  look at mode and network, or correct transport.rate_hz
preflight.first_command firm: live
  the flow's first command is not finite, or the flow raises an error
  the run would end before the robot moves
  mend the block that the line names
preflight.disk firm: live
  less than 1 GB is free where a recording would be written
  the recording would end in the middle of the run
  make room, or record to another folder
"""

RULES = tuple(
    Rule(*row) for row in re.findall(r"^(\S+) (\w+): (.*)\n  (.*)\n  (.*)\n  (.*)", TABLE, re.M)
)

CODES = {rule.code: rule for rule in RULES}
"""Code to rule. A workflow accepts one with `check: {accept: [CODE]}`: it is then a note."""

LIVE = frozenset(rule.code for rule in RULES if rule.needs == "live")
"""What the running robot alone shows; no finding of `unicon check` has such a code."""

FIRM = frozenset(rule.code for rule in RULES if rule.firm)
"""What a run cannot begin with."""


def live_code(name: str) -> str:
    """Return the code of a gate, or of another row of preflight; "" for a name that has none."""
    codes = (f"{group}.{name.replace(' ', '_')}" for group in ("gate", "preflight"))
    return next((code for code in codes if code in LIVE), "")
