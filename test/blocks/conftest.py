"""Blocks are built on the bench that outsiders have too."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_core.testing import Bench


class RandomBench(Bench):
    """A bench whose states can be filled at random."""

    def randomize(self, rng: np.random.Generator) -> None:
        """Fill every float state with random values, the orientation with a unit quaternion."""
        for name in self.states:
            view = self.states[name]
            if view.dtype == np.float32:
                view[...] = rng.uniform(-2, 2, view.shape)
        self.states.base_quat /= np.linalg.norm(self.states.base_quat, axis=-1, keepdims=True)
        self.states.joint_stiffness = np.abs(self.states.joint_stiffness) * 20
        self.states.joint_damping = np.abs(self.states.joint_damping)


@pytest.fixture
def bench():
    """Builds a bench of a robot, with a batch axis where asked."""
    return RandomBench
