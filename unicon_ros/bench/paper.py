"""The rows of UniCon's own latency table, out of ours, for `unicon bench latency`.

The paper ("UniCon: A Unified System for Efficient Robot Learning Transfers", section "Framework
Efficiency") tells mean ± standard deviation in [µs] on an H1 with identity control at 50 Hz and
states at about 500 Hz. Its *End-to-end* ends when the command is sent, not when it is at the robot:
that is our `state_to_command`. Its *Recv* is how long it takes to obtain the states; ours begins
with their stamp, and has their way to us in it.
"""

from __future__ import annotations

from collections.abc import Iterable

from unicon_ros.bench.report import Bench

ROWS = {"Recv": "recv", "Send": "send", "End-to-end": "state_to_command"}
"""The paper's row to ours."""

DEFINITIONS = (
    "Recv: time to obtain the latest states, here from their stamp on; Send: time to transmit the "
    "command; End-to-end: from the stamp of the states to the send of the command that depends on "
    "them (our state_to_command); mean ± std (p50, p99) in µs"
)

THEIRS = {
    "SDK (sync)": "Recv 1261 ± 150, Send 1011 ± 72, End-to-end 1805 ± 1559",
    "SDK (async)": "Recv –, Send 1001 ± 65, End-to-end 1447 ± 936",
    "ROS 2": "Recv 50 ± 88, Send 587 ± 179, End-to-end 1658 ± 882",
    "UniCon": "Recv 63 ± 15, Send 190 ± 45, End-to-end 732 ± 749",
}
"""The paper's table, on its machine; no p50 and p99 are told."""


def beside_paper(bench: Bench, variants: Iterable[str]) -> None:
    """Add the paper's table, and the same rows of variants that were measured, as facts.

    Args:
        bench: with the cases of the variants, each `VARIANT: ROW`.
        variants: names; those without a command have no such rows and are left out.
    """
    bench.facts["the paper's rows"] = DEFINITIONS
    for name, told in THEIRS.items():
        bench.facts[f"paper, {name}"] = told
    for name in variants:
        if f"{name}: {ROWS['End-to-end']}" in bench.cases:
            rows = [f"{word} {_told(bench, f'{name}: {row}')}" for word, row in ROWS.items()]
            bench.facts[f"here, {name}"] = ", ".join(rows)


def _told(bench: Bench, name: str) -> str:
    case = bench.cases.get(name)
    if case is None:
        return "–"
    numbers = {key: f"{case[key]:.{0 if case[key] >= 20.0 else 1}f}" for key in case}
    return f"{numbers['mean']} ± {numbers['std']} ({numbers['p50']}, {numbers['p99']})"
