"""Speed of joints whose robot tells angles alone."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from unicon_hardware.wire import Speed

STEPS = st.lists(st.integers(0, 40_000_000), min_size=2, max_size=30)


@given(steps=STEPS)
def test_it_is_the_difference_of_angles_far_enough_apart(steps: list[int]) -> None:
    speed, over = Speed(0.03), 30_000_000
    stamps = np.cumsum(steps).tolist()
    angles = np.random.default_rng(0).normal(size=(len(steps), 2))
    for k, now in enumerate(stamps):
        told = speed(now, angles[k])
        # The newest one that is far enough back; where none is, the first.
        then = max((j for j in range(k) if now - stamps[j] >= over), default=0)
        seconds = max(now - stamps[then], 1_000_000) * 1e-9
        np.testing.assert_allclose(told, (angles[k] - angles[then]) / seconds)
