"""The files that the fuzz begins with where `config/` has none that says as much."""

from __future__ import annotations

from pathlib import Path

__all__ = [
    "AGIBOT",
    "ARGUMENTS",
    "DEPLOY",
    "ENCODINGS",
    "ENV",
    "FOREIGN",
    "HUMANOID",
    "INCLUDED",
    "LEGGED_GYM",
    "LEROBOT",
    "LIMX",
    "MEMBERS",
    "ONE_BLOCK",
    "PLATFORMS",
    "REPLAYS",
    "SAFETY",
    "SCENES",
    "SET_PATHS",
    "STARTS",
    "SWEEP",
    "URDF",
    "WORKFLOWS",
    "XML_SNIPPETS",
]

_CONFIG = Path(__file__).resolve().parents[2] / "config" / "workflows"

POSTURES = """\
schema: unicon.workflow/1
name: postures
robot: go2
platform: fake
scene: {initial_pose: rest, noise: {joint_vel: 0.1}, delay: 1, seed: 3, joints: {}}
platforms: {fake: {time_constant: 0.05}, mujoco: {timestep: 0.002}}
rate: 50
duration: 3.0
states:
  crouch: {shape: [3], dtype: float32, unit: rad, frame: base, initial: [0.1, 0.2, 0.3]}
  lean: {shape: [3]}
  count: {shape: [], dtype: int64, initial: 0}
pacing: {trigger: deadline, overrun: skip, spin_us: 50, arrival_spin_us: 0, dry_run_us: 500}
check: {accept: [action.scale], duration: 2.0, command: [0.5, 0.0, 0.0]}
commands:
  - velocity_command: {schedule: [[0.0, 0.0, 0.0, 0.0], [1.0, 0.5, 0.0, 0.2]], ramp: 1.0}
  - linear_map: {source: velocity_command, target: lean, scale: [0.4, 0.1, 0.2], offset: 0.0}
flow:
  chain:
    - pose: {to: {"*_hip_joint": 0.1, FR_thigh_joint: 0.9}, duration: 0.5, fade_in: 0.2}
    - loop:
        do: {sway: {gains: {"*_thigh_joint": [0.2, 0, 0]}, amplitude: [0.1, 0, 0], frequency: 0.5}}
        until: "lean[0] > 0.1 or (tick > 100 and abs(base_ang_vel[2]) < 0.5 ** 2)"
    - excite: {signal: chirp, joints: ["R*"], amplitude: {"*": 0.1}, fade: 0.2, duration: 0.5}
    - every: {n: 2, do: {hold: {duration: 0.2}}}
    - when: {if: {tilted: {angle: 0.5}}, do: {hold: {duration: 0.5}}}
    - switch: {on: "tick > 50", cases: {a: {hold: {duration: 1.0}}, b: damp}, blend: 0.2}
    - zip: [{hold: {duration: 1.0}}, {elapsed: 0.5}, {settled: {}}]
    - damp: {duration: 0.5}
safety:
  - finite
  - joint_limits: {margin: 0.02}
  - rate_limit: {max_rate: 10.0}
  - effort_limits
  - tilt_stop: {angle: 1.0}
  - velocity_stop: {factor: 1.5}
deferred:
  - copy: {source: velocity_command, target: crouch, index: [0, 1, 2]}
"""

CALLS = """\
robot: go2
platform: fake
rate: 50
states: {battery_charge: {}, motor_temperature: , observation: {shape: [3]}, action: {shape: [2]}}
safety:
  only:
    - finite
    - joint_limits: {margin: 0.02, beyond: trip}
    - rate_limit: {max_rate: 10.0, beyond: trip}
    - effort_limits: {scale: 2.0, beyond: trip}
    - tracking_stop: {bound: 0.5, timeout: 0.2}
    - power_stop: {limit: 500.0, loss: 0.1, timeout: 0.1}
    - height_stop: {lowest: -0.1, highest: 2.0}
    - overrun_stop: {count: 5, window: 0.5}
    - action_stop: {limit: 10.0}
commands:
  - copy: {source: joint_pos, target: action, index: [0, 1]}
  - copy: {source: joint_vel, target: observation, index: [0, 1, 2]}
deferred: [{observation_range: {file: good.npz}}]
flow:
  zip:
    - call: "unicon_core.blocks.postures:Hold"
    - call: {function: "unicon_core.blocks.safety.stops:Finite", name: again}
    - deferred: {call: {function: "unicon_core.blocks.safety.stops:tilted", angle: 1.0}}
"""

WALK = """\
robot: go2
platform: fake
rate: 100
policies:
  walk: {path: go2_velocity, given: {period: 0.02, action.scale: 0.25}}
shadow:
  walk: {path: go2_velocity, given: {period: 0.02}, blend: 0.2, bound: 0.5, limit: 0.05}
commands: [{velocity_command: {constant: [0.5, 0.0, 0.0], limits: [[-1, 1], [-1, 1], [-1, 1]]}}]
flow:
  chain:
    - pose: {to: stand, duration: 1.0}
    - loop: {do: {policy: walk}, until: {elapsed: 10.0}}
"""

FOLLOWS = """\
robot: go2
platform: fake
rate: 50
estimate: [{frames: {of: {toe: FR_calf, hip: FR_hip}, frame: world}}, leg_odometry]
flow:
  zip:
    - forward_command:
        moves: ["F*"]
        max_rate: 6.0
        silent: home
        home_rate: 0.5
        stiffness: {"*_hip_joint": 30.0}
        damping: 1.0
        start_tolerance: 0.5
    - forward_command: {moves: ["R*"], silent: hold, integral: 1.0, name: rear}
wind_down: {external: {segment: commands, timeout: 0.2}}
safety: [finite, joint_limits]
"""

STARTS = """\
robot: go2
platform: fake_robot
rate: 50
states: {observation: {shape: [3]}, battery_charge: {initial: 1.0}, motor_temperature: }
start: {gates: true, operator: false, approach: 0.3, fade_in: 2.0, at: {every: 10}, late: go}
commands:
  - copy: {source: joint_vel, target: observation, index: [0, 1, 2]}
flow: {pose: {to: stand, duration: 1.0}}
wind_down: {chain: [{pose: {to: rest, duration: 2.0}}, {damp: {duration: 0.5}}]}
safety:
  - finite
  - range_stop: {margin: 0.5, factor: 3.0}
  - command_stop: {stiffness: 100.0, damping: 10.0, factor: 2.0}
  - imu_stop: {timeout: 0.2, motion: 0.3, angle: 0.35}
  - encoder_stop: {timeout: 0.1, motion: 0.1}
  - stale_stop: {timeout: 0.1}
  - tilt_stop: {angle: 1.0}
  - observation_stop: {file: good.npz, margin: 0.5}
"""

URDF = """\
<?xml version="1.0" encoding="utf-8"?>
<robot name="one">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial><visual><geometry><mesh filename="base.stl"/></geometry></visual></link>
  <link name="leg"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="a_joint" type="revolute"><parent link="base"/><child link="leg"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="10"/></joint>
</robot>
"""

_LAUGHS = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12))

XML_SNIPPETS = (
    f'<!DOCTYPE l [<!ENTITY l0 "ha">{_LAUGHS}]>',
    '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>',
    '<!DOCTYPE x SYSTEM "http://127.0.0.1:1/x.dtd">',
    '<!DOCTYPE x [<!ENTITY % p SYSTEM "file:///dev/zero"> %p;]>',
    "&l11;", "&e;", "&lt;", "&#0;", "&#x110000;",
    '<include file="model.xml"/>', '<include file="/etc/passwd"/>', '<include file="/dev/zero"/>',
    '<include file="../../../x.xml"/>',
    '<compiler meshdir="/" texturedir="/proc/self"/>',
    '<extension><plugin plugin="mujoco.elasticity.cable"/></extension>',
    '<asset><mesh name="m" file="/dev/zero.stl"/></asset>',
    '<worldbody><replicate count="100000000"><geom size="1"/></replicate></worldbody>',
    '<worldbody><body><composite type="grid" count="1000 1000 1000"/></body></worldbody>',
    '<size memory="1000000000000P"/>', '<size njmax="2000000000" nconmax="2000000000"/>',
    '<option timestep="nan"/>', '<option timestep="-1"/>', '<option timestep="1e-300"/>',
    '<worldbody><replicate count="70"><include file="many.xml"/></replicate></worldbody>',
    '<worldbody><replicate count="&#57;99999"><geom size="1"/></replicate></worldbody>',
    '<worldbody><replicate sep="a>b" count="+999999"><body/></replicate></worldbody>',
    '<asset><model name="s" file="model.xml"/></asset>',
    '<asset><model name="s" file="body.xml"/></asset>'
    + "<worldbody>" + "".join(f'<attach model="s" body="b" prefix="p{k}"/>' for k in range(9))
    + "</worldbody>",
    '<include file="many.xml"/>' * 2, '<include file="loop.xml"/>', '<include file="pipe.xml"/>',
    '<asset><hfield name="h" file="pipe.xml" size="1 1 1 1"/></asset>',
    '<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>',
    '<asset><texture name="x" type="2d" builtin="checker" width="99999" height="99999"/></asset>',
    '<asset><mesh name="c" builtin="cone" params="1000000000 1"/></asset>',
    '<size nuser_body="2000000000" nkey="2000000000"/>', '<size nuserdata="2000000000"/>',
    '<worldbody><body name="w"><flexcomp type="grid" name="f" count="99 99 99" dim="3"/></body>'
    "</worldbody>",
    '<option gravity="nan 0 0" impratio="inf"/>',
    '<worldbody><body pos="nan inf 1e999"><freejoint/><geom size="1" mass="nan"/></body>'
    "</worldbody>",
    '<link name="n"><inertial><mass value="nan"/><inertia ixx="nan" iyy="inf" izz="-1" ixy="0" '
    'ixz="0" iyz="1e999"/></inertial><inertial/></link>',
    "<a>" * 3000 + "</a>" * 3000, '<default class="' + "9" * 9999 + '"/>',
    "<body>" * 500, "<a " + 'b="1" ' * 200 + "/>", "<![CDATA[", "<!--", "]]>", "\x00",
)  # fmt: skip

_THOUSAND = '<replicate count="1000"><geom size="1"/></replicate>'
INCLUDED = {
    "many.xml": f"<mujocoinclude><worldbody>{_THOUSAND}</worldbody></mujocoinclude>",
    "loop.xml": '<mujocoinclude><include file="loop.xml"/></mujocoinclude>',
    "body.xml": f'<mujoco><worldbody><body name="b">{_THOUSAND}</body></worldbody></mujoco>',
}
"""What snippets of XML include and attach."""

ENCODINGS = ("utf-16", "utf-16-be", "utf-32", "utf-7", "utf-8-sig", "latin-1", "cp037", "cp1140")

ONE_BLOCK = """\
robot: go2
platform: fake
rate: 50
states:
  observation: {shape: [3], initial: [0.1, 0.2, 0.3]}
  action: {shape: [2]}
  battery_charge: {initial: 1.0}
  battery_voltage: {initial: 28.0}
  motor_temperature:
  motor_error:
start: {operator: false, together: {robots: [left, right], me: left, group: fuzz, timeout: 5}}
flow: hold
"""

SAFETY = (
    "finite",
    "joint_limits: {margin: 0.02, beyond: trip}",
    "rate_limit: {max_rate: 10.0, beyond: trip}",
    "effort_limits: {scale: 2.0, beyond: trip}",
    "tilt_stop: {angle: 1.0}",
    "velocity_stop: {factor: 1.5, limit: 30.0}",
    "stale_stop: {timeout: 0.1}",
    "command_stop: {stiffness: 100.0, damping: 10.0, factor: 2.0}",
    "range_stop: {margin: 0.5, factor: 3.0}",
    "encoder_stop: {timeout: 0.1, motion: 0.1}",
    "imu_stop: {timeout: 0.2, motion: 0.3, angle: 0.35}",
    "hardware_stop: {temperature: 90.0, charge: 0.05, voltage: 24.0}",
    "tracking_stop: {bound: 0.5, timeout: 0.2}",
    "power_stop: {limit: 500.0, loss: 0.1, timeout: 0.1}",
    "height_stop: {lowest: -0.1, highest: 2.0}",
    "overrun_stop: {count: 5, window: 0.5}",
    "observation_stop: {file: good.npz, margin: 0.5}",
    "action_stop: {limit: 10.0}",
)

PACKAGES = """\
robot: package://unicon_ros/config/robots/go2.yaml
platform: mujoco
scene: {model: package://unicon_ros/config/models/go2/go2.xml}
policies: {walk: package://unicon_ros/config/policies/go2_velocity}
map: package://unicon_ros/config/maps/default.yaml
flow: {policy: walk}
"""
"""Files of packages; ours is one."""

REMOTE = """\
robot: go2
platform: fake
rate: 50
policies:
  walk:
    path: go2_velocity
    remote: {address: "tcp://127.0.0.1:5560", delay: 2, timeout: 0.3, keys: keys}
flow: hold
"""

PLATFORMS = (
    "robot: go2\nplatform: {child: fake, silence: 0.05, watchdog: 0.2}\nrate: 50\nflow: hold\n",
    "robot: {body: go2, left_hand: dex3_left}\nplatform: {body: fake, hands: {child: fake}}\n"
    "rate: 50\nflow: {zip: [{hold: , of: body}, {hold: , of: left_hand}]}\n",
)

SCENES = (
    """\
robot: go2
platform: mujoco
rate: 50
scene:
  initial_pose: {"*_hip_joint": 0.1, FR_thigh_joint: 0.9}
  initial_height: 0.4
  terrain: flat
  seed: 3
  delay: 1
  noise: {joint_vel: 0.1, base_ang_vel: 0.2, projected_gravity: 0.01}
  push: {every: 0.02, velocity: 0.5}
platforms: {mujoco: {timestep: 0.002}, fake: {time_constant: 0.05}}
flow: hold
""",
    """\
robot: go2
platform: mujoco
rate: 50
num_robots: 2
scene: {model: "assets:models/go2/go2.xml", initial_pose: "keyframe:home", noise: {joint_pos: 0.1}}
flow: hold
""",
    """\
robot: go2
platform: mujoco
rate: 50
scene: {terrain: {rough: {height: 0.04, spacing: 0.5, extent: 8, flat: 2, seed: 3}}}
flow: hold
""",
    """\
robot: go2
platform: mujoco
rate: 50
scene: {terrain: {patches: {friction: [0.2, 1.0], size: 1.0, extent: 8}}, seed: 2}
flow: hold
""",
    """\
robot: go2
platform: mujoco
rate: 50
scene: {terrain: {stairs: {rise: -0.1, run: 0.3, steps: 4, landing: 1.0}}}
flow: hold
""",
)

ARGUMENTS = (
    ["--seconds", "0.01"], ["--seconds", "nan"], ["--seconds", "1e308"], ["--seconds", "-1"],
    ["--seconds", "601"], ["--seconds", "9" * 5000], ["--seconds", "x"], ["--seconds", ""],
    ["--wiggle", "--yes"], ["--wiggle"], ["--wiggle", "--yes", "--angle", "0.1"],
    ["--wiggle", "--yes", "--angle", "nan"], ["--wiggle", "--yes", "--angle", "1e-300"],
    ["--wiggle", "--yes", "--angle", "0.2"], ["--wiggle", "--yes", "--angle", "1e300"],
    ["--wiggle", "--yes", "--angle", "-0.05"], ["--angle", "0"], ["--yes"],
    ["--json", "fuzzed.json"], ["--json", "fuzzed.no/folder.json"], ["--json", ""],
    ["--json", "fuzzed." + "x" * 300], ["--map", "nonexistent"], ["--no-ros"], ["--help"],
    ["another"],
    ["--set", "platform=fake"], ["--set", "platform=fake_robot"], ["--set", "platform=mujoco"],
    ["--set", "start=none"], ["--set", "start.gates=false"], ["--set", "safety=none"],
    ["--set", "safety={only: [finite]}"], ["--set", "rate=1000"], ["--set", "rate=nan"],
    ["--set", "num_robots=2"], ["--set", "flow=damp"], ["--set", "flow={pose: {to: rest}}"],
    ["--set", "flow={policy: x}"], ["--set", "robot=g1_29dof"], ["--set", "robot=dex3_left"],
    ["--set", "x"], ["--set", "=" * 50], ["--set", "a.b.c.d=1"], ["--set", "[[[[=1"],
)  # fmt: skip
"""Of `unicon preflight`."""

REPLAYS = (
    """\
robot: go2
platform: replay
platforms:
  replay:
    {bag: run.mcap, start: 0.04, loop: true, moment: sent, also: [velocity_command], each: true}
rate: 50
flow: {pose: {to: stand, duration: 1.0}}
""",
    """\
robot: go2
platform: fake
platforms: {replay: {bag: run.mcap}}
rate: 100
flow:
  chain:
    - recorded: {bag: run.mcap, take: [joint_pos_target], start: 0.1, approach: 0.2}
    - recorded: {bag: run.mcap}
    - damp: {duration: 0.1}
""",
)
"""Beside a recording of ten ticks at 50 Hz, named run.mcap."""

MEMBERS = """\
schema: unicon.workflow/1
robot: {body: go2, left_hand: inspire_rh56_left, right_hand: rohand}
platform: {body: fake, hands: fake}
platforms: {fake: {time_constant: 0.05}, left_hand: {time_constant: 0.1}}
scene: {initial_pose: rest, noise: {joint_vel: 0.1}, delay: 1}
rate: 50
duration: 3.0
flow:
  chain:
    - pose: {to: stand, duration: 0.2}
    - zip:
        - {hold: {duration: 0.4}, of: body}
        - {chain: [{pose: {to: {"L_*": 0.3}, duration: 0.2}}, hold], of: left_hand}
        - {damp: , of: right_hand}
safety: [finite, {joint_limits: {margin: 0.01}, of: left_hand}, joint_limits]
"""

WORKFLOWS = (
    STARTS,
    FOLLOWS,
    POSTURES,
    CALLS,
    WALK,
    MEMBERS,
    PACKAGES,
    REMOTE,
    *((_CONFIG / f"{name}.yaml").read_text("utf-8") for name in ("go2_walk", "go2_stand")),
)

SET_PATHS = (
    "start", "start.gates", "start.operator", "start.approach", "start.fade_in", "wind_down",
    "start.at", "start.at.every", "start.together", "start.together.robots", "start.late",
    "safety.only", "safety.1", "safety.7.observation_stop.file",
    "rate", "duration", "robot", "platform", "platforms", "scene", "flow", "safety",
    "safety.0", "commands", "commands.0", "states", "states.x", "states.tick", "policies",
    "policies.walk", "policies.walk.given", "shadow", "shadow.walk", "shadow.run", "check",
    "check.accept", "pacing", "num_robots", "map",
    "flow.chain.0", "flow.chain.0.pose.to", "flow.chain.1.loop.until", "deferred", "name", "ros",
    "robot.body", "robot.left_hand", "platform.body", "platform.hands", "platforms.left_hand",
    "schema", "description", "a", "", ".", "a.b.c", "safety.99", "flow.chain.x",
)  # fmt: skip

DEPLOY = """\
joint_ids_map: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]
step_dt: 0.02
stiffness: [25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0]
damping: [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]
default_joint_pos: [-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5]
commands:
  base_velocity:
    ranges: {lin_vel_x: [-0.5, 1.0], lin_vel_y: [-0.3, 0.3], ang_vel_z: [-0.2, 0.2], heading: null}
actions:
  JointPositionAction:
    clip: [[-10, 10]]
    joint_names: [.*]
    scale: [0.25]
    offset: [0.1]
    joint_ids: null
observations:
  base_ang_vel: {params: {}, clip: null, scale: [0.2, 0.2, 0.2], history_length: 1}
  projected_gravity: {params: {}, clip: [-1.0, 1.0], scale: null, history_length: 1}
  velocity_commands: {params: {command_name: base_velocity}, scale: [1.0, 1.0, 1.0]}
  joint_pos_rel: {params: {asset_cfg: {joint_ids: null}}, clip: [-10.0, 10.0], scale: [1.0]}
  joint_vel_rel: {params: {}, scale: [0.05], history_length: 1}
  last_action: {params: {}, scale: null, history_length: 1}
"""

ENV = """\
sim: {dt: 0.005, device: 'cuda:0'}
decimation: 4
scene:
  robot:
    init_state:
      joint_pos: {.R_hip_joint: -0.1, .L_hip_joint: 0.1, .*_thigh_joint: 0.8, .*_calf_joint: -1.6}
    actuators:
      legs: {joint_names_expr: [.*], stiffness: 40.0, damping: {.*_hip_joint: 1.0, .*: 1.0}}
observations:
  policy:
    concatenate_terms: true
    history_length: null
    base_ang_vel: {func: 'mdp.observations:base_ang_vel', clip: [-100.0, 100.0], scale: 0.2}
    projected_gravity: {func: 'mdp.observations:projected_gravity', scale: null, clip: null}
    velocity_commands: {func: 'mdp.observations:generated_commands', params: {}}
    joint_angles: {func: 'mdp.observations:joint_pos_rel', history_length: 1}
    joint_vel:
      func: mdp.observations:joint_vel_rel
      params:
        asset_cfg: {name: robot, joint_names: ['F.*', .*], joint_ids: [0, 1], preserve_order: true}
      modifiers: null
      scale: 0.05
    actions: {func: 'mdp.observations:last_action', params: {action_name: joint_pos}}
actions:
  joint_pos:
    class_type: isaaclab.envs.mdp.actions.joint_actions:JointPositionAction
    joint_names: ['.*']
    preserve_order: false
    scale: {.*_hip_joint: 0.25, '^(?!.*_hip_joint).*': 0.25}
    offset: 0.0
    use_default_offset: true
commands: {base_velocity: {ranges: {lin_vel_x: [-1.0, 1.0], heading: null}}}
"""

LEROBOT = """\
type: act
n_obs_steps: 1
input_features:
  observation.state: {type: STATE, shape: [12]}
  observation.environment_state: {type: ENV, shape: [3]}
  observation.images.front: {type: VISUAL, shape: [3, 8, 8]}
output_features: {action: {type: ACTION, shape: [12]}}
chunk_size: 20
n_action_steps: 5
temporal_ensemble_coeff: null
"""

LEGGED_GYM = """\
init_state:
  default_joint_angles: {FR_hip_joint: -0.1, FR_thigh_joint: 0.8, FR_calf_joint: -1.5}
control:
  stiffness: {hip: 20.0, thigh: 20.0, calf: 30.0}
  damping: {hip: 0.5, joint: 0.6}
  action_scale: 0.25
  decimation: 4
sim: {dt: 0.005}
normalization:
  obs_scales: {ang_vel: 0.25, dof_vel: 0.05}
  clip_actions: 100.0
commands:
  ranges: {lin_vel_x: [-1.0, 1.0], ang_vel_yaw: [-2.0, 2.0]}
"""

FOREIGN = """\
schema: unicon.policy/1
onnx: policy.onnx
period: 0.02
joints: [FR_hip_joint, FR_thigh_joint, FR_calf_joint, FL_hip_joint, FL_thigh_joint, FL_calf_joint,
  RR_hip_joint, RR_thigh_joint, RR_calf_joint, RL_hip_joint, RL_thigh_joint, RL_calf_joint]
default_joint_pos: [-0.1, 0.8, -1.6, 0.1, 0.8, -1.6, -0.1, 0.8, -1.6, 0.1, 0.8, -1.6]
action: {scale: 0.25, joints: [FR_hip_joint, FR_thigh_joint], extra: rate}
stiffness: 40.0
damping: 1.0
observation:
  layout: frame_major
  terms:
  - {name: angles, state: base_rpy}
  - {name: gait, value: [2.0, 0.5, 0.5, 0.1], history: 2, scale: 2.0}
  - {name: share, state: motion_phase}
  - {name: clock, state: gait_phase}
  - {name: command, state: velocity_command, scale: 2.0}
  - {name: joint_pos, state: joint_pos, subtract: default_joint_pos}
  - {name: last_action, state: action}
  - {name: pad, value: [0.0, 0.5]}
  - {name: more, state: rate}
phase: {period: 1.0, rate: {state: rate, index: 9, scale: 2.0, offset: 1.0}}
motion: {duration: 2.0, start: 0.1, hold: 0.1}
inputs: {observation: obs}
outputs: {action: actions}
recurrent: [{input: memory, output: next_memory}]
"""

HUMANOID = """\
class ToyCfg(LeggedRobotCfg):
    class env(LeggedRobotCfg.env):
        frame_stack = 15
        num_single_obs = 47
        num_actions = 12
    class init_state:
        default_joint_angles = {
            "FR_hip_joint": -0.1, "FR_thigh_joint": 0.8, "FR_calf_joint": -1.6,
            "FL_hip_joint": 0.1, "FL_thigh_joint": 0.8, "FL_calf_joint": -1.6,
            "RR_hip_joint": -0.1, "RR_thigh_joint": 0.8, "RR_calf_joint": -1.6,
            "RL_hip_joint": 0.1, "RL_thigh_joint": 0.8, "RL_calf_joint": -1.6,
        }
    class control:
        stiffness = {"hip": 40.0, "thigh": 40.0, "calf": 40.0}
        damping = {"joint": 1.0}
        action_scale = 0.25
        decimation = 10
    class sim:
        dt = 0.001
    class rewards:
        cycle_time = 0.64
    class commands:
        class ranges:
            lin_vel_x = [-0.3, 0.6]
    class normalization:
        class obs_scales:
            lin_vel = 2.0
            ang_vel = 1.0
            dof_pos = 1.0
            dof_vel = 0.05
            quat = 1.0
        clip_observations = 18.0
        clip_actions = 18.0
"""

LIMX = """\
PointfootCfg:
  loop_frequency: 500
  joint_names: [abad_L_Joint, ankle_L_Joint, abad_R_Joint, ankle_R_Joint]
  init_state:
    default_joint_angle: {abad_L_Joint: 0.1, ankle_L_Joint: 0, abad_R_Joint: 0, ankle_R_Joint: 0}
  control: {stiffness: 42.0, damping: 2.5, ankle_joint_damping: 1.5, action_scale_pos: 0.25,
    wheel_joint_damping: 0.8, decimation: 10}
  normalization:
    clip_scales: {clip_actions: 100.0}
    obs_scales: {ang_vel: 0.25, dof_pos: 1.0, dof_vel: 0.05}
  size: {observations_size: 24, encoder_output_size: 3}
  gait: {frequencies: 1.3, swing_height: 0.12}
  imu_orientation_offset: {roll: 0.0, pitch: 0.0, yaw: 0.0}
  user_cmd_scales: {lin_vel_x: 1.5, lin_vel_y: 1.0, ang_vel_yaw: 0.5}
"""

AGIBOT = """\
control_frequecy: 1000
controllers:
  rl_walk:
    joint_list: [FR_hip_joint, FR_thigh_joint]
    init_state: [-0.1, 0.8]
    stiffness: [40.0, 40.0]
    damping: [1.0, 1.0]
    walk_step_conf:
      {action_scale: 0.25, decimation: 10, cycle_time: 0.7, sw_mode: true, cmd_threshold: 0.05}
    obs_scales: {lin_vel: 2.0, ang_vel: 1.0, dof_pos: 1.0, dof_vel: 0.05, quat: 1.0}
    onnx_conf: {policy_file: cfg/policy.onnx, actions_size: 2, observations_size: 17, num_hist: 3,
      observations_clip: 100.0, actions_clip: 100.0}
    lpf_conf: {wc: 100.0, ts: 0.001, paralle_list: [FR_thigh_joint]}
"""

SWEEP = """\
schema: unicon.sweep/1
workflow: go2_walk
set: {platform: mujoco}
vary:
  scene.payload: {uniform: [0.0, 2.0]}
  policies.walk.given.action.scale: [0.2, 0.25]
sample: random
rollouts: 10
seed: 3
repeat: 2
duration: 2.0
early_stop: fall
keep: [joint_pos, base_pos_w]
timeout: 60.0
engine: local
gate: [fall<0.1]
"""
