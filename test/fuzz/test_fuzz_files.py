"""Mutated files of every kind: one clear error or none, never a trace, a hang or an execution.

By hand: `python test/fuzz/test_fuzz_files.py KIND [COUNT [SEED]]` prints each distinct finding.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

WORKER = Path(__file__).with_name("worker.py")
KINDS = (
    "workflow",
    "set",
    "robot",
    "policy",
    "deploy",
    "map",
    "onnx",
    "recording",
    "start",
    "record",
    "model",
    "safety",
    "sweep",
    "scene",
    "preflight",
    "bag",
    "replay",
)
QUICK, THOROUGH = 100, 5000
FEWER = {"start": 40, "safety": 40, "scene": 40, "preflight": 30, "bag": 10, "replay": 15}
"""Quick cases of the kinds whose cases take longest."""
SEED = 7
STUCK_S = 120.0
"""Wall time of one case beyond which a process is ended: it hangs where no signal reaches."""


class Workers:
    """Runs workers one after the other, each a fork of a process that has imported all of it."""

    def __init__(self) -> None:
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [sys.executable, str(WORKER)], stdin=pipe, stdout=pipe, bufsize=0
        )

    def run(self, kind: str, seed: int, first: int, count: int, out: Path) -> str:
        """Return how a worker ended, and the last of what it said."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        spoken = out.with_suffix(".txt")
        asked = [kind, seed, first, count, str(out), str(spoken)]
        self._process.stdin.write(json.dumps(asked).encode() + b"\n")
        worker = int(self._process.stdout.readline())
        size, since = -1, time.monotonic()
        while not select.select([self._process.stdout], [], [], 0.5)[0]:
            now = out.stat().st_size
            if now != size:
                size, since = now, time.monotonic()
            elif time.monotonic() - since > STUCK_S:
                os.kill(worker, signal.SIGKILL)
                self._process.stdout.readline()
                return "stuck"
        status = int(self._process.stdout.readline())
        said = spoken.read_bytes() if spoken.exists() else b""
        return f"status {status}: {said[-1500:].decode('utf-8', 'replace')}"

    def close(self) -> None:
        """End them."""
        self._process.kill()
        self._process.communicate()


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    """Processes that read the files."""
    made = Workers()
    yield made
    made.close()


def fuzz(
    workers: Workers, kind: str, count: int, seed: int
) -> tuple[Counter[str], list[dict[str, Any]]]:
    """Run cases 0 … count - 1 of a kind; a worker that dies is replaced after the case it had."""
    verdicts: Counter[str] = Counter()
    findings: list[dict[str, Any]] = []
    first = 0
    with tempfile.TemporaryDirectory() as folder:
        while first < count:
            out = Path(folder) / f"{first}.jsonl"
            out.touch()
            status = workers.run(kind, seed, first, count - first, out)
            told = [json.loads(line) for line in out.read_text("utf-8").splitlines()]
            done = [one for one in told if "done" in one]
            verdicts.update(one["verdict"] for one in done)
            findings += [one for one in done if one["verdict"] not in ("accepted", "refused")]
            first += len(done)
            if first < count:
                died = told[-1].get("case", first) if told else first
                findings.append({"done": died, "verdict": "died", "detail": status, "files": {}})
                verdicts["died"] += 1
                if not told:
                    break
                first = died + 1
    return verdicts, findings


def told(kind: str, seed: int, findings: list[dict[str, Any]]) -> str:
    """Return each distinct finding with one of its files and how to run it alone."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for one in findings:
        last = one["detail"].strip().splitlines()[-1:] or [""]
        places = [line for line in one["detail"].splitlines() if "/unicon_" in line]
        groups.setdefault(f"{one['verdict']}: {last[0][:160]} {places[-1:]}", []).append(one)
    parts = []
    for title, ones in sorted(groups.items(), key=lambda item: -len(item[1])):
        one = ones[0]
        files = "\n".join(f"--- {name}\n{text}" for name, text in one["files"].items())
        parts.append(
            f"{len(ones)} × {title}\n"
            f"worker.py {kind} {seed} {one['done']} 1 /dev/stdout\n{one['detail']}\n{files}"
        )
    return "\n\n".join(parts)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", KINDS)
def test_some_mutated_files_are_read_or_refused_in_one_line(workers: Workers, kind: str) -> None:
    count = FEWER.get(kind, QUICK)
    verdicts, findings = fuzz(workers, kind, count, SEED)
    assert not findings, told(kind, SEED, findings)
    assert verdicts["refused"] > count // 10, verdicts
    assert verdicts.total() == count


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_thousands_of_mutated_files_are_read_or_refused_in_one_line(
    workers: Workers, kind: str
) -> None:
    verdicts, findings = fuzz(workers, kind, THOROUGH, SEED + 1)
    assert not findings, told(kind, SEED + 1, findings)
    assert verdicts["refused"] > THOROUGH // 10, verdicts
    assert verdicts.total() == THOROUGH


if __name__ == "__main__":
    asked = sys.argv[1]
    number = int(sys.argv[2]) if len(sys.argv) > 2 else QUICK
    dice_seed = int(sys.argv[3]) if len(sys.argv) > 3 else SEED
    began = time.monotonic()
    counted, found = fuzz(Workers(), asked, number, dice_seed)
    print(told(asked, dice_seed, found))
    print(f"{asked}: {dict(counted)} in {time.monotonic() - began:.0f} s")
