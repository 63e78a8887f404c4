"""What the Go2 velocity policy sees and commands, for training, export and evaluation alike.

Joint vectors stand in the vendor's motor order (FR, FL, RR, RL x hip, thigh, calf), which is also
the order of `config/models/go2/go2.xml`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

CONFIG = Path(__file__).resolve().parents[2] / "config"
MODEL_PATH = CONFIG / "models" / "go2" / "go2.xml"
POLICY_DIR = CONFIG / "policies" / "go2_velocity"
STAIRS_DIR = CONFIG / "policies" / "go2_stairs"

PERIOD = 0.02  # control period in [s]
LEGS = ("FR", "FL", "RR", "RL")
JOINTS = tuple(f"{leg}_{part}_joint" for leg in LEGS for part in ("hip", "thigh", "calf"))
# Standing pose in [rad], shape (12,): the pose of key frame `home`.
DEFAULT_JOINT_POS = np.tile([-0.1, 0.8, -1.6, 0.1, 0.8, -1.6], 2).astype(np.float32)
EFFORT_LIMIT = np.tile([23.7, 23.7, 45.43], 4).astype(np.float32)  # [N·m]
# In [N·m/rad] and [N·m·s/rad]: soft enough to forgive impacts, stiff enough to carry the stance.
STIFFNESS = 40.0
DAMPING = 1.0
ACTION_SCALE = 0.25  # [rad] of target per unit of action
ACTION_CLIP = 8.0

# Observation terms in the order of the network's input: (name, size, scale).
TERMS = (
    ("base_ang_vel", 3, 0.25),
    ("projected_gravity", 3, 1.0),
    ("velocity_command", 3, 2.0),
    ("joint_pos_rel", 12, 1.0),
    ("joint_vel_rel", 12, 0.05),
    ("last_action", 12, 1.0),
)
NUM_OBS = sum(size for _, size, _ in TERMS)
OBS_SCALE = np.concatenate([np.full(size, scale) for _, size, scale in TERMS]).astype(np.float32)
# The command ranges of the acceptance test; training samples a little beyond them.
COMMAND_LOW = np.array([-0.5, -0.4, -1.0], np.float32)  # vx, vy in [m/s], wz in [rad/s]
COMMAND_HIGH = np.array([1.0, 0.4, 1.0], np.float32)

# The height scan of go2_stairs: points x, y around the base in [m], turned by its yaw, shape
# (187, 2), x fastest; a point's value is the height of the base above the ground there in [m].
SCAN_SIZE, SCAN_RESOLUTION = (1.6, 1.0), 0.1
_AXES = [np.arange(round(s / SCAN_RESOLUTION) + 1) * SCAN_RESOLUTION - s / 2 for s in SCAN_SIZE]
SCAN = np.stack([axis.ravel() for axis in np.meshgrid(*_AXES)], axis=1)
SCAN_HEIGHT = 0.3  # subtracted: that of standing
SCAN_CLIP = 1.0
SCAN_SCALE = 8.0  # of training, in the first layer's weights after export: 8 cm must not drown


def scaled_scan(heights: np.ndarray) -> np.ndarray:
    """What the network takes of a scan in [m] while it is trained."""
    return SCAN_SCALE * np.clip(heights - SCAN_HEIGHT, -SCAN_CLIP, SCAN_CLIP)
