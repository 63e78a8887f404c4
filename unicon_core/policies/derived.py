"""States that a policy's terms read and no robot reports: angles of the base, and constants.

`base_rpy` are roll, pitch and yaw of `base_quat` in [rad]: turns about the fixed axes x, then y,
then z of the world, roll and yaw in (−π, π], pitch in [−π/2, π/2]. Its sources agree:
roboterax/humanoid-gym `scripts/sim2sim.py` (quaternion_to_euler_array; `envs/base/legged_robot.py`
puts Isaac Gym's angles from [0, 2π) there) and AgibotTech/agibot_x1_infer
`control_module/rotation_tools.h` (QuatToXyz).
"""

from __future__ import annotations

import math

from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.states import StateSpec

RPY = "base_rpy"


def derived_states(contract: PolicyContract) -> dict[str, StateSpec]:
    """Return the states that are derived for a policy: `base_rpy` where it is read, constants."""
    states = {
        term.state: StateSpec(
            (len(term.value),), description="constant", initial=tuple(term.value.tolist())
        )
        for term in contract.terms
        if term.value is not None
    }
    if RPY in (*contract.inputs, *(term.state for term in contract.terms)):
        angles, text = ("roll", "pitch", "yaw"), "base orientation, turned about x, y, z"
        states[RPY] = StateSpec((3,), "float32", "rad", "world", angles, text)
    return states


class RollPitchYaw:
    """Writes `base_rpy` each tick, before the policy.

    Args:
        states: with it and `base_quat`.
    """

    memory = ()

    reads = ("base_quat",)
    writes = (RPY,)

    def __init__(self, states: PackedStates) -> None:
        self._quat, self._angles = states["base_quat"].reshape(-1, 4), states[RPY].reshape(-1, 3)

    def __call__(self) -> None:
        """Write the angles of all robots."""
        self._angles[...] = [
            (
                math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                math.asin(max(min(2.0 * (w * y - z * x), 1.0), -1.0)),
                math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            )
            for w, x, y, z in self._quat.tolist()
        ]

    def reset(self) -> None:
        """It remembers nothing."""
