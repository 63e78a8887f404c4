"""`unicon doctor`: what is wrong with a machine is found, with its remedy, and nothing else."""

from __future__ import annotations

import json
import resource
from pathlib import Path
from types import SimpleNamespace

import pytest

from unicon_core.latches import ESTOP, Latch
from unicon_ros.cli import doctor
from unicon_ros.cli.doctor import Finding, examine
from unicon_ros.cli.main import main


def found(name: str) -> Finding:
    (finding,) = (each for each in examine() if each.name == name)
    return finding


def test_each_area_is_looked_at_and_what_is_not_ok_has_a_remedy(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["doctor", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    areas = [each["area"] for each in told]
    assert [*dict.fromkeys(areas)] == [
        "python", "packages", "ros", "network", "robots", "time", "scheduling", "left", "disks",
    ]  # fmt: skip
    for each in told:
        assert each["said"]
        assert bool(each["remedy"]) == (each["level"] != "ok"), each


def test_the_text_has_a_line_for_each_and_says_how_many_need_a_look(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        doctor,
        "examine",
        lambda: [
            Finding("ros", "domain", "error", "999", "export it"),
            Finding("a", "b", "ok", "c"),
        ],
    )
    assert main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "✗  ros  domain  999\n     export it" in out
    assert "1 of 2 need a look" in out


@pytest.mark.parametrize("value", ["233", "-1", "seven"])
def test_a_domain_that_cannot_be_is_an_error(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", value)
    assert found("domain").level == "error"
    monkeypatch.setenv("ROS_DOMAIN_ID", "232")
    assert found("domain").level == "ok"


def test_a_latch_is_found_with_the_command_that_lets_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNICON_LATCHES", str(tmp_path))
    assert found("latches").level == "ok"
    latch = Latch("/robot1/unicon", 0, ESTOP, print)
    latch.set("pressed")
    assert latch.kept()
    latch.close()
    finding = found("latch of /robot1/unicon")
    assert (finding.level, finding.remedy) == (
        "warning",
        "unicon latches --clear /robot1/unicon",
    )


def test_few_open_files_are_found() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (512, hard))
    try:
        assert found("open files").level == "warning"
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.parametrize(
    ("name", "path", "text"),
    [
        ("clock source", "current_clocksource", "hpet"),
        ("CPU governor", "scaling_governor", "powersave"),
    ],
)
def test_what_the_kernel_says_is_judged(
    name: str, path: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "glob", lambda *_: [Path("cpu0") / path])
    monkeypatch.setattr(doctor, "_text", lambda asked: text if asked.name == path else "")
    assert found(name).level == "warning"


def test_stolen_time_is_told_as_a_share_of_all_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter(range(100))
    monkeypatch.setattr(doctor, "_stolen", lambda: next(ticks) * 0.1)
    assert found("stolen time").level == "warning"


def test_a_robot_whose_network_an_interface_has_is_near(monkeypatch: pytest.MonkeyPatch) -> None:
    assert found("a1, aliengo, go1").level == "note"
    monkeypatch.setattr(doctor, "_source_of", lambda address: "192.168.123.162")
    finding = found("a1, aliengo, go1")
    assert (finding.level, finding.said) == ("ok", "192.168.123.10 from 192.168.123.162")


def test_an_area_that_fails_hides_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> list[object]:
        raise PermissionError("no")

    monkeypatch.setattr(doctor.socket, "if_nameindex", broken)
    told = [each for each in examine() if each.area in ("network", "disks")]
    assert told[0].said == "PermissionError: no"
    assert len(told) > 1


def test_a_full_disk_and_a_package_that_is_absent_are_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _: SimpleNamespace(free=1e6))
    assert found("faults").level == "warning"
    monkeypatch.setitem(doctor.PACKAGES, "no_such_package", "sim")
    assert found("no_such_package").remedy == "pip install 'unicon_ros[sim]'"
