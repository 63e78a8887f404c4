"""`unicon sweep compare` says how likely the difference of two shares of falls is by chance."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from unicon_lab.sweep.report import comparison

pytest.importorskip("scipy")


def results(name: str, fell: list[bool], seed: int) -> Any:
    places = list(range(len(fell)))
    return SimpleNamespace(
        path=name,
        good=places,
        rows=places,
        identity={"seed": seed},
        said={"programs": {}},
        versions={},
        every=lambda figure: fell if figure == "fell" else [None] * len(fell),
    )


@pytest.mark.parametrize(
    ("seed", "fell", "others", "p"),
    [
        # Fisher: hypergeometric, two-sided; by hand C(10,5) C(10,1) / C(20,6) and smaller ones.
        (1, [True] * 5 + [False] * 5, [True] + [False] * 9, "0.14"),
        (1, [True] * 9 + [False], [False] * 9 + [True], "0.0011"),
        (0, [True] * 6 + [False] * 4, [False] * 10, "0.031"),  # McNemar: 2 / 2^6
        (0, [True, False] * 5, [True, False] * 5, "1"),
    ],
)
def test_the_probability_is_that_of_the_exact_test(
    seed: int, fell: list[bool], others: list[bool], p: str
) -> None:
    text = comparison(results("a", fell, 0), results("b", others, seed))
    row = next(line for line in text.splitlines() if line.startswith("fell"))
    assert p in row.split()
    assert ("differs" in row) is (float(p) < 0.05)
