"""Our rows under the names of the paper's table."""

from __future__ import annotations

from unicon_ros.bench.report import Bench
from unicon_ros.bench.rounds import PAPER_ROWS, TABLES, beside_paper


def made() -> Bench:
    bench = Bench("latency", seed=0, rounds=1)
    for row, value in {"recv": 200.0, "state_to_command": 300.0, "end_to_end": 400.0}.items():
        bench.case(f"ours: {row}", [value - 10.0, value, value + 10.0])
    bench.case("observer: mirror", [1.0])
    beside_paper(bench, ["ours", "observer"])
    return bench


def test_their_end_to_end_ends_at_send_as_our_state_to_command() -> None:
    assert PAPER_ROWS["End-to-end"] == "state_to_command"
    assert made().facts["here, ours"] == (
        "Recv 200 ± 8.2 (200, 210), Send –, End-to-end 300 ± 8.2 (300, 310)"
    )


def test_who_sends_no_command_has_no_row_and_the_paper_has_all() -> None:
    facts = made().facts
    assert "here, observer" not in facts
    theirs = {name for name in facts if "paper" in name}
    assert theirs == {*TABLES["paper"]}
    assert len(theirs) == 5
    for word in PAPER_ROWS:
        assert f"{word}: " in facts["the paper's rows"]
        assert f"{word} " in facts["paper, UniCon"]
