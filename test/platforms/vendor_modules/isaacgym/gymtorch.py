"""Stand-in for isaacgym.gymtorch: descriptors to tensors and back, over the same memory.

docs/programming/tensors.html of Isaac Gym Preview 4.
"""

from __future__ import annotations

from torch import Tensor
from vendor_world import exact

from isaacgym.gymapi import Descriptor


def wrap_tensor(gym_tensor: Descriptor, /) -> Tensor:
    exact(gym_tensor, Descriptor, "gym_tensor")
    return Tensor(gym_tensor.array)


def unwrap_tensor(torch_tensor: Tensor, /) -> Descriptor:
    exact(torch_tensor, Tensor, "torch_tensor")
    return Descriptor(torch_tensor.numpy())
