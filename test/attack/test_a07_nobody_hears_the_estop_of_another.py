"""Two processes that ask for a ROS domain at once get two: one would hear the other's stop."""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Iterator

import pytest

from unicon_ros.bench import report

ASK = """\
import random, sys
random.SystemRandom.sample = lambda *_: [97, 98, *range(40, 90)]
from unicon_ros.bench.report import free_domain
print(free_domain(), flush=True)
sys.stdin.read()
"""


@pytest.fixture
def other() -> Iterator[subprocess.Popen[str]]:
    """A process that has asked, and is in no domain yet."""
    while report._kept:  # of tests before this one
        report._kept.popitem()[1].close()
    command = [sys.executable, "-c", ASK]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process
        process.kill()


@pytest.mark.skipif(sys.platform != "linux", reason="the mark is an abstract socket")
def test_a_domain_is_given_to_one_process(
    other: subprocess.Popen[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert other.stdout is not None
    taken = int(other.stdout.readline())
    wanted = [taken, *(d for d in range(90, 96) if d != taken)]
    monkeypatch.setattr(random.SystemRandom, "sample", lambda *_: wanted)
    assert report.free_domain() != taken
