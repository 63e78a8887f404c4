"""Domains that benchmarks and tests run in: free ones, no two alike."""

from __future__ import annotations

import socket

import pytest

from unicon_ros.bench import report


def test_a_domain_with_a_participant_is_taken_only_for_want_of_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken, free = report.free_domains(2)
    monkeypatch.setattr(report, "_DOMAINS", (taken, free))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("", 7400 + 250 * taken + 10))

        assert {report.free_domain() for _ in range(16)} == {free}
        assert report.free_domains(2) == [free, taken]


def test_domains_differ() -> None:
    found = report.free_domains(101)

    assert sorted(found) == list(range(1, 102))
