"""Pool: every row has one result, whichever workers die, and one that kills its workers ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from unicon_base.errors import UniconError
from unicon_lab.sweep.plan import Row
from unicon_lab.sweep.pool import AHEAD, HOPELESS, TRIES, Pool, PoolWorker, Result

ROWS = [Row(index, 0, (), (f"x={index}",)) for index in range(9)]


class Worker(PoolWorker):
    """Does one row a turn; dies in place of it where the pool has a death left."""

    def __init__(self, name: int, pool: FakePool) -> None:
        super().__init__(name, "LOG", ready=False)
        self.pool, self.why = pool, ""

    def send(self, row: Row) -> None:
        assert self.ready
        assert len(self.rows) <= AHEAD
        self.pool.sent.append(row.index)

    def heard(self) -> Iterator[dict[str, Any]]:
        if not self.ready:
            self.ready = True
        elif self.rows and self.pool.dies(self.rows[0][0].index):
            self.why = "ended by SIGKILL"
        elif self.rows:
            yield {"row": {"outcome": "done"}, "why_not": ""}

    def gone(self, timeout: float) -> str:
        return self.why

    def end(self, why: str) -> str:
        return why


class FakePool(Pool):
    """Workers that die as they are told.

    Args:
        deaths: whether the worker whose turn it is dies, turn by turn; then none does.
        bad: a row that kills every worker.
    """

    def __init__(self, deaths: Iterable[bool] = (), bad: int = -1, count: int = 2) -> None:
        super().__init__(count, 60.0)
        self._deaths_left, self._bad = iter(deaths), bad
        self.sent: list[int] = []

    def dies(self, index: int) -> bool:
        return index == self._bad or next(self._deaths_left, False)

    def start(self, name: int) -> PoolWorker:
        return Worker(name, self)

    def look(self) -> Iterable[PoolWorker]:
        return list(self._workers)


def results_of(pool: FakePool) -> list[Result]:
    results = list(pool.run(ROWS))
    pool.close()
    return results


@given(st.lists(st.booleans(), max_size=20), st.integers(1, 4))
def test_each_row_has_one_result_whoever_dies(deaths: list[bool], count: int) -> None:
    pool = FakePool([*deaths[:10], False, *deaths[10:]], count=count)  # 12 in a row are hopeless
    results = results_of(pool)
    assert sorted(result.index for result in results) == [row.index for row in ROWS]
    again = {index for index in pool.sent if pool.sent.count(index) > TRIES}
    assert (
        not {r.index for r in results if r.figures["outcome"] == "crashed"}
        - again
        - {index for index in pool.sent if pool.sent.count(index) == TRIES}
    )


def test_a_row_that_kills_its_workers_is_crashed_and_costs_no_other() -> None:
    results = {result.index: result.figures for result in results_of(FakePool(bad=4))}
    assert results.pop(4)["text"] == f"{TRIES} times: ended by SIGKILL"
    assert {figures["outcome"] for figures in results.values()} == {"done"}


def test_workers_that_only_die_end_the_sweep() -> None:
    with pytest.raises(UniconError) as told:
        results_of(FakePool([True] * 100))
    assert str(told.value) == (
        f"{HOPELESS} workers ended one after the other, the last one so: ended by SIGKILL; see LOG"
    )
