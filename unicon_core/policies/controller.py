"""What is asked of any controller, for whoever builds a program or checks it.

A policy is one; inverse kinematics or a predictive controller stands beside it in the same way: its
tick has an attribute `contract` that says this much.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol, cast

import numpy as np

from unicon_base.arrays import Array
from unicon_base.errors import WorkflowError
from unicon_core.flow import Block


class ControllerContract(Protocol):
    """What a controller says of itself; a `PolicyContract` says all of it.

    Attributes:
        name: for messages.
        period: control period in [s]; a faster program runs it every n-th tick.
        joints: the joints that it commands, length n.
        default_joint_pos: the pose that it begins with in [rad], shape (n,).
        command_ranges: `lin_vel_x`, `lin_vel_y`, `ang_vel_z` -> lowest and highest command that it
            can follow, to which the velocity command is held where it reads that.
    """

    @property
    def name(self) -> str: ...
    @property
    def period(self) -> float: ...
    @property
    def joints(self) -> tuple[str, ...]: ...
    @property
    def default_joint_pos(self) -> Array: ...
    @property
    def command_ranges(self) -> Mapping[str, tuple[float, float]]: ...


_FACTS = tuple(name for name in vars(ControllerContract) if not name.startswith("_"))


def controller_contract(block: Block) -> ControllerContract | None:
    """Return what the controller in a block says of itself, None where it is not a controller.

    Raises:
        WorkflowError: it leaves something out, or what it says does not fit together.
    """
    contract = getattr(block.tick, "contract", None)
    if contract is None:
        return None
    what = _wrong(contract)
    if not what:
        return cast(ControllerContract, contract)
    raise WorkflowError(
        f"block {block.name!r}: its contract {what}; a controller says {', '.join(_FACTS)}, "
        "the period in [s] above 0, one position in [rad] for each joint, ranges as (lowest, "
        "highest)",
        block.where or None,
    )


def _wrong(contract: Any) -> str:
    lacking = [name for name in _FACTS if not hasattr(contract, name)]
    if lacking:
        return f"does not say {', '.join(lacking)}"
    period, ranges, joints = contract.period, contract.command_ranges, contract.joints
    if not isinstance(period, (int, float)) or not 0.0 < period < math.inf:
        return f"says period {period!r}"
    if not isinstance(ranges, Mapping) or any(np.shape(r) != (2,) for r in ranges.values()):
        return f"says command_ranges {ranges!r}"
    if np.shape(joints) != np.shape(contract.default_joint_pos) or np.ndim(joints) != 1:
        return f"has {np.size(contract.default_joint_pos)} positions for {np.size(joints)} joints"
    return ""
