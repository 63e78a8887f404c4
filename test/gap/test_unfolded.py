"""Unfolded MSE: what the UniCon authors' own code computes; clear errors."""

from __future__ import annotations

import os
import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aligned_twins import unfolded
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import UniconError
from unicon_core.metrics import aligned_mse, unfolded_mse

LOSSES = os.environ.get("UNICON_LOSSES", "")
"""Path of `unicon/losses.py` of https://github.com/CreeperLin/unicon, which is not copied here."""


@given(st.integers(2, 40), st.integers(1, 40), st.integers(1, 4), st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_it_equals_its_definition(m: int, more: int, d: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    real, sim = 5.0 + random.normal(size=(m // 2 - 1 + more, d)), random.normal(size=(m, d))
    assert float(unfolded_mse(real, sim)) == pytest.approx(unfolded(real, sim), rel=1e-9)


def test_places_begin_at_0_and_each_direction_has_its_own() -> None:
    whole = np.cumsum(np.random.default_rng(5).normal(size=(237, 12)), axis=0)
    early, late = whole[37:], whole[:200]
    ahead = np.min([((late[:100] - early[p : p + 100]) ** 2).mean() for p in range(101)])
    assert float(unfolded_mse(early, late)) == pytest.approx(0.5 * ahead)
    assert float(unfolded_mse(late, early)) == pytest.approx(0.5 * ahead)
    assert float(aligned_mse(early, late).loss) == 0.0
    time = np.arange(500)
    walk = np.stack([np.sin(2 * np.pi * (time + phase) / 50) for phase in (0, 25)], axis=1)
    assert float(unfolded_mse(walk, np.roll(walk, 10, axis=0))) < 1e-25


def test_leading_axes_give_the_results_of_one_after_the_other() -> None:
    random = np.random.default_rng(0)
    real, sims = random.normal(size=(200, 3)), random.normal(size=(2, 5, 180, 3))
    found = unfolded_mse(real, sims)
    assert found.shape == (2, 5)
    for index in np.ndindex(2, 5):
        assert found[index] == unfolded_mse(real, sims[index])


@pytest.mark.parametrize(
    ("real", "sim", "message"),
    [
        (np.zeros((4, 2)), np.zeros((1, 2)), "gap: real has 4 samples, sim 1; sim must have at"),
        (np.zeros((4, 2)), np.zeros((10, 2)), "gap: real has 4 samples, sim 10; sim must have at"),
        (np.zeros((5, 3)), np.zeros((5, 2)), "gap: real has 3 elements, sim 2; choose those"),
        ([[0.0], [np.nan]], [[0.0], [0.0]], "gap: real is nan in sample 1, element 0; leave such"),
    ],
)
def test_what_cannot_be_compared_is_refused(real: Any, sim: Any, message: str) -> None:
    with pytest.raises(UniconError, match=re.escape(message)):
        unfolded_mse(real, sim)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [(200, 200), (199, 199), (2, 2), (260, 200), (120, 200)])
def test_it_is_what_their_code_computes(samples: tuple[int, int]) -> None:
    torch: Any = pytest.importorskip("torch", reason="pip install 'unicon_ros[torch]'")
    if not Path(LOSSES).is_file():
        pytest.skip("set UNICON_LOSSES to unicon/losses.py of github.com/CreeperLin/unicon")
    theirs = runpy.run_path(LOSSES)["unfolded_mse_loss"]
    random = np.random.default_rng(3)
    for scale in (1e-3, 1.0, 1e3):
        real, sim = (
            scale * np.cumsum(random.normal(size=(4, count, 12)), axis=1) for count in samples
        )
        loss = theirs(torch.from_numpy(sim), torch.from_numpy(real)).numpy()
        np.testing.assert_allclose(unfolded_mse(real, sim), loss, rtol=1e-9)
