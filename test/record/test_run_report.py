"""`unicon report-run`: what ran, by nobody's name, at the level that a recording shows at most."""

from __future__ import annotations

import errno
import getpass
import json
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rosbags")

from unicon_base.errors import Fault
from unicon_base.resources import sha256_of
from unicon_core.flow import Block, Stage
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_lab import fault_record
from unicon_lab.evidence_report.report import HERE, report_of
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording.run_recording import Recording
from unicon_ros.cli.main import main

keygen = pytest.mark.skipif(
    shutil.which("ssh-keygen") is None, reason="no ssh-keygen: apt install openssh-client"
)
UNICON = (sys.executable, "-m", "unicon_ros")
CONFIG = Path(__file__).resolve().parents[2] / "config"
USER, PLACE, ADDRESS, CARD = "zaphod_b", "betelgeuse", "192.168.7.33", "enp7s0"
FOLDER = "/".join(("", "home", USER, "secret"))
SECRETS = (USER, PLACE, ADDRESS, CARD, "home", "secret", "00:1b:44", "SN4711", "mywifi", "1234567")
TEXT = (
    f"joint FL_hip_joint of {USER}@{PLACE} is stuck: 0.35 rad at 12:34:56, {ADDRESS} on {CARD} "
    f"({FOLDER}/walk.yaml:12), 00:1b:44:11:3a:b7, serial SN4711 1234567, 'mywifi'"
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a shipped workflow in MuJoCo."""
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    path = tmp_path_factory.mktemp("walk") / "walk.mcap"
    assert main(["run", "go2_walk", "--duration=4.2", "--speed=max", f"--record={path}"]) == 0
    return path


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Makes a recording as of a robot of metal: of `fake_robot`, with other facts."""

    def record(fault: str = "", **facts: Any) -> Path:
        """Record 30 ticks, or up to a fault.

        Args:
            fault: its text.
            facts: in place of those that it has; `options` are of platform `unitree`.
        """
        options = facts.pop("options", {"address": CARD})
        folder = tmp_path / USER
        folder.mkdir(exist_ok=True)
        values = {
            "schema": "unicon.workflow/1",
            "name": f"{PLACE}_walk",
            "description": f"{USER} walks in {PLACE}",
            "robot": "go2",
            "platform": "fake_robot",
            "rate": 50,
            "duration": 0.6,
            "flow": "hold",
        }
        path = folder / "secret.yaml"
        path.write_text(yaml.safe_dump(values), "utf-8")
        said = {"platform": "unitree", "platforms": {"unitree": options}}
        changed = {"platform": "unitree", "workflow_effective": yaml.safe_dump(values | said)}
        honest = fault_record.facts_of
        monkeypatch.setattr(
            fault_record, "facts_of", lambda *given: honest(*given) | changed | facts
        )

        def damage(program: Program) -> HookBlocks:
            tick = program.states["tick"]

            def work() -> None:
                if fault and tick.flat[0] >= 10:
                    raise Fault(fault)

            return {Stage.OBSERVE: [Block("damage", work)]}

        recording = Recording(tmp_path / "run.mcap", warn=str, namespace=f"/{PLACE}")
        record = FaultRecord(str(tmp_path / "faults"), str, recording)
        hooks = [damage, recording.hook, record.hook]
        program = Program(load_document(path), hooks=hooks)
        runner = Runner(program, RunOptions(warn=str, operator=False))
        record.attach(runner)
        record.write(runner.run())
        return tmp_path / "run.mcap"

    monkeypatch.setenv("UNICON_FAULTS", str(tmp_path / "faults"))
    return record


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run the command, which is refused in one line; return it."""
    assert main(["report-run", *map(str, arguments)]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    return told


def reported(path: Path, out: Path, *more: str) -> dict[str, Any]:
    assert main(["report-run", str(path), f"--out={out}", *more]) == 0
    found: dict[str, Any] = yaml.safe_load(out.read_text("utf-8"))
    return found


# -- what is told ----------------------------------------------------------------------------------


def test_a_simulated_run_is_told_and_is_never_one_of_the_robot(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = reported(bag, tmp_path / "report.yaml")
    printed = capsys.readouterr().out
    assert printed.startswith((tmp_path / "report.yaml").read_text("utf-8"))
    assert "signature  none; --sign KEY makes one" in printed
    assert (report["level"], report["robots"]) == ("never", {"go2": "unitree_go"})
    assert report["platforms"] == ["mujoco"]
    assert report["workflow"] == "go2_walk"
    assert report["workflow_sha256"] == sha256_of(CONFIG / "workflows" / "go2_walk.yaml")
    assert report["robot_sha256"] == sha256_of(CONFIG / "robots" / "go2.yaml")
    assert len(report["network_sha256"]) == 1
    assert (report["ticks"], report["duration_s"], report["overruns"]) == (210, 4.2, 0)
    assert report["walked_s"] == pytest.approx(0.2)
    assert report["recording_sha256"] == [sha256_of(bag)]
    assert not {"period_us", "observation_age_us"} & set(report)  # its time is the simulator's
    line = refused(capsys, bag, "--hardware")
    assert "was not on hardware: its platform, or a part of it, is simulated; leave" in line


def test_a_folder_is_told_with_its_end_and_all_of_its_files(tmp_path: Path) -> None:
    split = ["--record-split=1s", f"--record={tmp_path}/walk/"]
    assert main(["run", "go2_stand", "--duration=3", "--speed=max", "--quiet", *split]) == 0
    report = report_of(tmp_path / "walk")
    assert (report["ticks"], report["overruns"]) == (150, 0)
    files = [tmp_path / "walk" / f"walk_{number}.mcap" for number in range(20)]
    files = [path for path in files if path.exists()]
    assert len(files) > 1
    assert report["recording_sha256"] == [sha256_of(path) for path in files]


def test_nothing_of_a_user_is_in_a_report(recorded: Callable[..., Path], tmp_path: Path) -> None:
    options = {
        "address": CARD,
        "peer": f"{USER} {ADDRESS}",
        "domain": 1234567,
        "layout": PLACE + "!",
        "silence": 0.5,
        "silent": False,
        "serial": "SN4711",
        SECRETS[0]: 1,
    }
    system = {
        "os": f"{PLACE} Linux",
        "architecture": USER,
        "kernel": f"6.8.0-45-{PLACE}",
        "ros": PLACE,
        "middleware": USER,
        "commit": FOLDER,
        "host": PLACE,
    }
    versions = {"unicon_ros": f"0.1.0+{USER}", "numpy": "2.1", USER: "1.0"}
    facts = {"system": system, "versions": versions}
    told = {name: json.dumps(fact) for name, fact in facts.items()}
    bag = recorded(TEXT, options=options, **told)
    text = bag.read_bytes()
    assert all(secret.encode() in text for secret in (USER, PLACE, CARD))
    report = reported(bag, tmp_path / "report.yaml", "--hardware")
    text = (tmp_path / "report.yaml").read_text("utf-8")
    mine = (getpass.getuser(), platform.node(), str(Path.home()), str(tmp_path))
    for secret in (*SECRETS, *(name for name in mine if len(name) > 4)):
        assert secret not in text, secret
    assert report["level"] == "hardware"
    assert report["workflow"] == "other"
    assert report["options"] == {"silence": 0.5, "silent": False}
    assert report["versions"] == {"unicon_ros": "0.1.0", "numpy": "2.1"}
    assert report["kernel"] == "6.8.0-45"
    assert not {"os", "architecture", "ros", "middleware", "commit"} & set(report)
    assert report["faults"] == ["joint FL_hip_joint of … is stuck: 0.35 rad at … on … serial …"]
    (fault,) = (tmp_path / "faults").glob("*.mcap")
    assert report_of(fault, True)["faults"] == report["faults"]


def test_of_a_robot_periods_ages_and_the_day_are_told(recorded: Callable[..., Path]) -> None:
    report = report_of(recorded())
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", report["date"])
    assert report["period_us"]["max"] >= report["period_us"]["p50"] > 0.0
    assert report["observation_age_us"]["max"] >= report["observation_age_us"]["p50"]
    assert report["late_us"]["max"] >= report["late_us"]["p50"] >= 0.0
    assert report["faults"] == []
    assert re.fullmatch(r"x86_64|aarch64", report["architecture"])


def test_a_fault_whose_record_is_gone_is_still_one(
    recorded: Callable[..., Path], tmp_path: Path
) -> None:
    bag = recorded("the base leans by 1.20 rad")
    assert report_of(bag)["faults"] == ["the base leans by 1.20 rad"]
    shutil.rmtree(tmp_path / "faults")
    assert report_of(bag)["faults"] == ["its text is in the fault record, which is not here"]


# -- levels ----------------------------------------------------------------------------------------


def slow(*values: Any) -> Any:
    """Return parameters of a test that `make test-slow` runs."""
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("facts", "level", "why"),
    [
        ({}, "hardware", "who reports says so"),
        ({"platform": "fake_robot"}, "never", "is simulated"),
        slow({"platform": "unitree+mujoco"}, "never", "is simulated"),
        slow({"platform_facts": ""}, "never", "is simulated"),
        ({"dry": "true"}, "never", "nothing was sent"),
        ({"options": {"address": "127.0.0.1"}}, "stand_in", "loopback"),
        slow({"options": {"address": "lo"}}, "stand_in", "loopback"),
        slow({"options": {"device": "/dev/pts/4"}}, "stand_in", "virtual"),
        slow({"robot_file": "transport: {address: 127.3.0.1}"}, "stand_in", "loopback"),
        ({"options": {"peer": "unitree_mujoco"}}, "vendor", "simulator"),
    ],
    ids=str,
)
def test_the_level_is_what_the_recording_shows_at_most(
    recorded: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
    facts: dict[str, Any],
    level: str,
    why: str,
) -> None:
    bag = recorded(**facts)
    alone = report_of(bag)
    assert alone["level"] == ("stand_in" if level == "hardware" else level)
    if level == "hardware":
        assert "nobody said" in alone["because"]
        report = report_of(bag, hardware=True)
        assert report["level"] == level
        assert why in report["because"]
    else:
        assert why in alone["because"]
        assert why in refused(capsys, bag, "--hardware")


@pytest.mark.parametrize(
    ("text", "here"),
    [
        *[(text, True) for text in ("127.0.0.1:8007", "udp://127.9.1.1", "::1", "[::1]:5", "LO")],
        *[(text, True) for text in ("localhost", "tcp://localhost:5", "0.0.0.0", "vcan1", "lo0")],
        *[(text, False) for text in ("192.168.127.1", "eth0", "10.127.0.1", "can0", "loop", "")],
    ],
)
def test_where_no_robot_of_metal_is(text: str, here: bool) -> None:
    assert bool(HERE.fullmatch(text)) == here


# -- files -----------------------------------------------------------------------------------------


def test_what_is_no_whole_recording_of_a_run_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    raw = bag.read_bytes()
    for name, content in {
        "empty": b"",
        "text": b"hello, robot",
        "cut": raw[: len(raw) // 2],
    }.items():
        (tmp_path / f"{name}.mcap").write_bytes(content)
    (tmp_path / "folder").mkdir()
    before = sorted(tmp_path.iterdir())
    assert "empty.mcap is not a record of ticks: it is empty; give" in refused(capsys, "empty.mcap")
    assert "it does not begin as MCAP does; give" in refused(capsys, "text.mcap")
    assert "is cut off, or being written; unicon bag recover" in refused(capsys, "cut.mcap")
    assert "no such file or folder; correct the name" in refused(capsys, "nothing.mcap")
    assert "folder has no recording in it; give a file" in refused(capsys, "folder")
    assert "give the recording BAG of a run, or --verify FILE" in refused(capsys)
    assert sorted(tmp_path.iterdir()) == before
    npz, imported = tmp_path / "a.npz", tmp_path / "imported.mcap"
    joints = ["--joints", *load_robot("go2").joint_names]
    np.savez(npz, states_q=np.zeros((4, 12)), rec_dt=0.02)
    assert main(["bag", "import", str(npz), str(imported), "--robot=go2", *joints]) == 0
    assert "imported.mcap is of no run of one robot; give one of" in refused(capsys, imported)


def test_a_file_that_is_there_stays_without_force(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, beside = tmp_path / "report.yaml", tmp_path / "report.yaml.sig"
    out.write_text("mine", "utf-8")
    assert "report.yaml exists; give another --out, or --force" in refused(
        capsys, bag, f"--out={out}"
    )
    assert out.read_text("utf-8") == "mine"
    beside.write_text("of before", "utf-8")
    reported(bag, out, "--force")
    assert not beside.exists()
    assert "/dev/null exists; give another --out\n" in refused(
        capsys, bag, "--out=/dev/null", "--force"
    )


def test_nothing_half_made_is_left_of_a_full_disk(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = [*UNICON, "report-run", str(bag), f"--out={tmp_path / 'a.yaml'}"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "make room" in done.stderr
    honest = Path.write_bytes

    def full_disk(path: Path, content: bytes) -> int:
        honest(path, content[:10])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    line = refused(capsys, bag, f"--out={tmp_path / 'b.yaml'}")
    assert "b.yaml: No space left on device; give a path in a writable folder with room" in line
    assert "cannot write" in refused(capsys, bag, f"--out={tmp_path / 'no' / 'b.yaml'}")
    assert list(tmp_path.iterdir()) == []


# -- signatures ------------------------------------------------------------------------------------


@pytest.fixture
def key(tmp_path: Path) -> Callable[[str], Path]:
    """Makes a key of SSH."""

    def make(name: str) -> Path:
        path = tmp_path / name
        command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "", "-f", str(path)]
        subprocess.run(command, check=True)
        return path

    return make


@keygen
def test_a_signature_holds_for_this_report_of_this_recording_by_this_key_alone(
    bag: Path, tmp_path: Path, key: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    out, beside = tmp_path / "report.yaml", tmp_path / "report.yaml.sig"
    mine, theirs = key("mine"), key("theirs")
    known, others = tmp_path / "known", tmp_path / "others"
    known.write_text(f"me@there {mine.with_suffix('.pub').read_text('utf-8')}", "utf-8")
    others.write_text(f"you@there {theirs.with_suffix('.pub').read_text('utf-8')}", "utf-8")
    reported(bag, out, f"--sign={mine}")
    verify = ["report-run", f"--verify={out}"]
    assert main([*verify, f"--bag={bag}"]) == 0
    told = capsys.readouterr().out
    assert f"{bag} is the recording of it" in told
    assert 'Good "unicon-run" signature with ED25519 key SHA256:' in told
    assert main([*verify, f"--allowed-signers={known}"]) == 0
    assert "signature for me@there with" in capsys.readouterr().out
    line = refused(capsys, *verify[1:], f"--allowed-signers={others}")
    assert f"report.yaml is signed by no key of {others}: " in line
    assert "absent is not there" in refused(capsys, *verify[1:], "--allowed-signers=absent")
    shutil.copy(bag, tmp_path / "other.mcap")
    with (tmp_path / "other.mcap").open("ab") as other:
        other.write(b"\0")
    line = refused(capsys, *verify[1:], f"--bag={tmp_path / 'other.mcap'}")
    assert "report.yaml is of another recording than" in line

    signature, text = beside.read_bytes(), out.read_text("utf-8")
    out.write_text(text.replace("level: never", "level: hardware"), "utf-8")
    assert "is not what report.yaml.sig signs: " in refused(capsys, *verify[1:])
    out.write_text(text, "utf-8")
    beside.write_bytes(signature[: len(signature) // 2])
    assert "is not what report.yaml.sig signs: " in refused(capsys, *verify[1:])
    beside.unlink()
    line = refused(capsys, *verify[1:])
    assert "report.yaml.sig is not there; sign with --sign KEY" in line
    command = ["ssh-keygen", "-q", "-Y", "sign", "-n", "file", "-f", str(mine), str(out)]
    subprocess.run(command, check=True, capture_output=True)
    assert "is not what report.yaml.sig signs: " in refused(capsys, *verify[1:])


@keygen
def test_a_key_that_does_not_sign_leaves_no_report(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, bag, f"--out={tmp_path / 'a.yaml'}", f"--sign={tmp_path / 'none'}")
    assert "none (give a key, or FILE.pub of one that ssh-agent has): " in line
    assert list(tmp_path.iterdir()) == []


def test_without_ssh_keygen_the_package_is_named(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    line = refused(capsys, bag, f"--out={tmp_path / 'a.yaml'}", "--sign=key")
    assert "ssh-keygen is not there, which makes and checks signatures: apt install" in line
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_report_is_not_verified(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.yaml").write_text("schema: unicon.robot/1", "utf-8")
    line = refused(capsys, f"--verify={tmp_path / 'a.yaml'}")
    assert "a.yaml is no report of a run: give what unicon report-run has written" in line
    assert "none.yaml" in refused(capsys, f"--verify={tmp_path / 'none.yaml'}")
    assert "give the recording BAG" in refused(capsys, bag, f"--verify={tmp_path / 'a.yaml'}")
