"""Zero: where a GR-1's actuators count from, found with its absolute encoders; for its wire.

An actuator counts from where it was switched on. The encoder at its joint knows where that was.
"""

from __future__ import annotations

import numpy as np

from unicon_core.errors import Fault
from unicon_ros.hardware.fourier.fsa1_codec import Servos

SAMPLES = 10
"""Of each encoder, whose mean counts."""
APART = 3.0
"""Two samples of a joint's zero may differ by so much, in [deg] of the actuator."""


class Zero:
    """See the module.

    Args:
        servos: of the robot.

    Attributes:
        offset: what is to be added to what an actuator tells, in [deg], shape (n,); 0 for a joint
            without encoder.
    """

    def __init__(self, servos: Servos) -> None:
        self._servos = servos
        self.offset = np.zeros(len(servos.names))
        self._samples: list[list[float]] = [[] for _ in servos.encoders]

    @property
    def missing(self) -> list[int]:
        """The encoders that have not answered often enough."""
        return [i for i, samples in enumerate(self._samples) if len(samples) < SAMPLES]

    def told(self, encoder: int, angle: float, position: float) -> None:
        """Take a sample.

        Args:
            encoder: which.
            angle: what it tells, [deg].
            position: what its actuator told at the same time, [deg].

        Raises:
            Fault: samples contradict each other.
        """
        samples, servos = self._samples[encoder], self._servos
        if len(samples) == SAMPLES:
            return
        turned = (angle - servos.encoder_zero[encoder] + 180.0) % 360.0 - 180.0
        samples.append(float(turned * servos.encoder_degrees[encoder]) - position)
        if len(samples) < SAMPLES:
            return
        apart = max(samples) - min(samples)
        if apart > APART:
            raise Fault(
                f"fourier: encoder {servos.encoders[encoder]} of {servos.names[encoder]} and its "
                f"actuator disagree by {apart:.1f} deg within {SAMPLES} samples; keep the robot "
                "still until it is connected, and look at the encoder"
            )
        self.offset[encoder] = float(np.mean(samples))
