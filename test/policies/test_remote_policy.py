"""A policy whose network is at a server: in step, at real rate, and when either end is wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from slow_network import workflow, write_slow

from unicon_base.errors import PolicyError, UniconError, WorkflowError
from unicon_base.resources import same_modules
from unicon_core.check import check_workflow, graph
from unicon_core.policies import load_policy
from unicon_core.policies.chunks import RemoteSpec
from unicon_core.policies.networks import child, remote
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.report import Report
from unicon_core.workflow import Program, load_workflow

zmq = pytest.importorskip("zmq")
pytest.importorskip("onnxruntime", reason="the networks are ONNX")
from chunk_network import write_chunks  # noqa: E402
from remote_peers import asking, make_keys, served, serving  # noqa: E402

from tools.chunks.slow_link import SlowLink  # noqa: E402
from unicon_core.policies.networks import remote_server  # noqa: E402
from unicon_core.policies.networks.remote_server import PolicyServer  # noqa: E402

RISING = [{"velocity_command": {"schedule": [[0.0, 0.2, 0.0, 0.0], [0.2, 0.8, 0.0, 0.0]]}}]
STANDS = {
    "chain": [
        {"loop": {"do": {"policy": "slow"}, "until": "action_age > 0.1"}},
        {"pose": {"to": "stand", "duration": 0.2}},
        "hold",
    ]
}


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_slow(tmp_path_factory.mktemp("quick"))


@pytest.fixture(scope="module")
def wanted(quick: Path) -> str:
    return run(workflow(quick, True)).sha256_commands


@pytest.fixture(scope="module")
def server(quick: Path) -> Iterator[PolicyServer]:
    with serving(quick) as made:
        yield made


def run(values: dict[str, Any], duration: float = 0.4, speed: Any = "max") -> Report:
    program = Program(**values)
    options = RunOptions(duration=duration, speed=speed, warn=lambda _: None)
    return Runner(program, options).run()


def raw(address: str) -> Any:
    socket = zmq.Context.instance().socket(zmq.DEALER)
    socket.setsockopt(zmq.LINGER, 0)
    socket.connect(address)
    return socket


@pytest.mark.parametrize("delay", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_commands_are_those_of_a_child(quick: Path, server: PolicyServer, delay: int):
    child = run(workflow(quick, {"delay": delay}))
    there = run(asking(quick, server.address, delay=delay))
    assert there.faults == []
    assert there.sha256_commands == child.sha256_commands
    found = there.extra["remote"]["slow"]
    assert 0.0 < found["inference_ms"]["p50"] < found["round_trip_ms"]["p50"]
    assert "remote        slow: round trip p50" in there.summary()


def test_times_are_states(quick: Path, server: PolicyServer):
    with closing(Program(**asking(quick, server.address))) as program:
        runner = Runner(program, RunOptions(speed="max", warn=lambda _: None))
        for _ in range(4):
            runner.tick(0)
        states = program.states
        assert 0.0 < states["action_inference"] < states["action_round_trip"] < 1.0
        assert states["action_age"] == np.float32(0.02)


@pytest.mark.slow
def test_go2_walks_as_far_as_with_a_child():
    with serving("go2_velocity") as made:
        reports = []
        for said in ({"child": {"delay": 1}}, {"remote": {"address": made.address}}):
            entry = {"path": "go2_velocity", **said}
            program = load_workflow("go2_walk", {"policies.walk": entry})
            options = RunOptions(duration=9.0, speed="max", warn=lambda _: None)
            reports.append(Runner(program, options).run())
    one, other = reports
    assert one.faults == []
    assert one.base_displacement_m == other.base_displacement_m
    assert one.base_displacement_m is not None
    assert one.base_displacement_m[0] > 2.5
    assert one.sha256_commands == other.sha256_commands


# -- what is refused ----------------------------------------------------------------------------


def test_another_network_is_refused(tmp_path: Path, server: PolicyServer):
    other = write_slow(tmp_path, turns=3)
    with pytest.raises(PolicyError) as caught:
        Program(**asking(other, server.address))
    mine, theirs = remote.contract_hash(load_policy(other)).hex(), server.digest.hex()
    assert f"has contract hash {theirs[:12]}… and this policy {mine[:12]}…" in str(caught.value)


def test_gains_are_no_part_of_the_hash_and_feedback_is(quick: Path):
    contract = load_policy(quick)
    same = replace(contract, stiffness=contract.damping, name="other")
    assert remote.contract_hash(same) == remote.contract_hash(contract)
    for other in (
        replace(contract, recurrent=()),
        replace(contract, outputs={"action": "h_out"}),
    ):
        assert remote.contract_hash(other) != remote.contract_hash(contract)


def test_keys_let_in_who_has_them(quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(remote, "START", 0.4)
    keys, strange = make_keys(tmp_path / "keys"), make_keys(tmp_path / "strange")
    half = tmp_path / "half"  # the server's key, and one of ours that it does not know
    half.mkdir()
    (half / "server.key").write_bytes((keys / "server.key").read_bytes())
    (half / "client.key_secret").write_bytes((strange / "client.key_secret").read_bytes())
    with serving(quick, keys=keys) as made:
        assert made.key.encode() in (keys / "server.key").read_bytes()
        assert run(asking(quick, made.address, keys=str(keys)), 0.1).faults == []
        for wrong in (None, str(strange), str(half)):
            with pytest.raises(PolicyError, match=r"has not answered for 0.4 s; .*remote.keys"):
                Program(**asking(quick, made.address, keys=wrong))
        assert run(asking(quick, made.address, keys=str(keys)), 0.1).faults == []
    with pytest.raises(UniconError, match="not a key file"):
        Program(**asking(quick, made.address, keys=str(tmp_path)))


def test_without_a_server_the_error_says_how_to_start_one(
    quick: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(remote, "START", 0.2)
    with pytest.raises(PolicyError, match=r"tcp://127.0.0.1:1 has not answered .*unicon serve"):
        Program(**asking(quick, "tcp://127.0.0.1:1"))


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({"address": "robot"}, "remote.address is 'robot'; write tcp://HOST:PORT"),
        ({"address": "tcp://*:5560"}, "remote.address"),
        ({"address": "tcp://h:5560", "delay": 0}, "remote.delay is 0"),
        ({"address": "tcp://h:5560", "timeout": 0.01}, "remote.timeout is 0.01 s, and by its"),
        ({}, "remote: missing key 'address'"),
        ({"address": "tcp://h:5560", "cpu": 1}, "unknown key 'cpu'"),
    ],
)
def test_what_is_said_wrong_is_refused(quick: Path, said: Any, told: str):
    values = workflow(quick, None)
    values["policies"]["slow"]["remote"] = said
    with pytest.raises((WorkflowError, PolicyError)) as caught:
        Program(**values)
    assert told in str(caught.value)


def test_networks_that_no_server_runs_are_named(quick: Path, server: PolicyServer):
    contract = replace(load_policy(quick), model=quick / "policy.pt")
    with pytest.raises(
        PolicyError, match=r"policy.pt: a server runs networks that say their sizes"
    ):
        remote.contract_hash(contract)
    there = remote.RemoteNetwork(replace(load_policy(quick), child=RemoteSpec(server.address)))
    with closing(there), pytest.raises(PolicyError, match="free sizes; export it with fixed ones"):
        there.bind({"obs": np.zeros((1, 40), np.float32)}, {})


def test_a_network_runs_in_one_place(quick: Path, server: PolicyServer):
    values = asking(quick, server.address)
    values["policies"]["slow"]["child"] = True
    with pytest.raises(WorkflowError, match="remote stands beside child; give one of them"):
        Program(**values)
    with pytest.raises(PolicyError, match="not num_robots 2; leave out remote"):
        Program(**asking(quick, server.address, num_robots=2))


@pytest.mark.parametrize("key", ["child", "remote"])
def test_further_outputs_are_refused_by_the_key_that_is_there(
    quick: Path, tmp_path: Path, server: PolicyServer, key: str
):
    values = yaml.safe_load((quick / "policy.yaml").read_text("utf-8"))
    values["action"]["extra"] = "pace"
    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(values), "utf-8")
    (tmp_path / "policy.onnx").write_bytes((quick / "policy.onnx").read_bytes())
    said = workflow(tmp_path, True) if key == "child" else asking(tmp_path, server.address)
    with pytest.raises(PolicyError, match=f"action.extra does not go with {key}; run it in the"):
        Program(**said)


def test_check_names_an_address_without_keys(
    quick: Path, server: PolicyServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(graph, "is_exposed", lambda _: True)
    path = tmp_path / "slow.yaml"
    path.write_text(yaml.safe_dump(asking(quick, server.address)), "utf-8")
    [found] = [each for each in check_workflow(path).findings if each.code == "zmq.keys"]
    assert f"{server.address} can be reached from other machines" in str(found)
    assert "write remote: {…, keys: FOLDER}" in str(found)


# -- what comes over the wire -------------------------------------------------------------------


class Noisy(PolicyServer):
    """Sends answers to other questions, cut ones and garbage before each that is right."""

    def _send(self, name: bytes, kind: int, *given: Any) -> None:
        if kind == remote.ANSWER:
            body, number, ns = bytes(given[0]), *given[1:]
            wrong = np.full(24, np.nan, np.float32).tobytes() + body[96:]  # with its number
            for each in (wrong[:-1], wrong[:9], wrong + b"x", b"")[number % 2 :: 2]:
                super()._send(name, kind, each, number, ns)
            for other in (number - 1, number + 1, 1 << 62, -1)[number % 2 :: 2]:
                super()._send(name, kind, wrong, other, ns)
            for parts in ([os.urandom(99)], [b"", b"", b""], [os.urandom(64), wrong]):
                self._end.socket.send_multipart([name, *parts])
        super()._send(name, kind, *given)


class Losing(PolicyServer):
    """Loses the first answer to every fifth question."""

    lost = 0

    def _send(self, name: bytes, kind: int, *given: Any) -> None:
        if kind == remote.ANSWER and given[1] % 5 == 0 and self.lost != given[1]:
            self.lost = given[1]
            return
        super()._send(name, kind, *given)


class Forgetful(PolicyServer):
    """Knows no robot any more at every eighth question, as after a restart."""

    def _hear(self, name: bytes, message: list[bytes]) -> None:
        if remote.unpacked(message)[1] % 8 == 7:
            self._robots.clear()
        super()._hear(name, message)


@pytest.mark.parametrize("kind", [Noisy, Losing, Forgetful])
def test_only_the_answer_to_the_newest_question_counts(quick: Path, wanted: str, kind: Any):
    with serving(quick, kind=kind) as made:
        found = run(asking(quick, made.address))
    assert found.faults == []
    assert found.sha256_commands == wanted


class Garbling(PolicyServer):
    """Answers with garbage alone from its sixth answer on: random, cut, of another question."""

    def _send(self, name: bytes, kind: int, *given: Any) -> None:
        if kind != remote.ANSWER or self.answered < 6:
            super()._send(name, kind, *given)
            return
        body, number, ns = bytes(given[0]), *given[1:]
        self._end.send([name, os.urandom(remote.HEAD.size), body])
        for wrong in (body[:-1], b"", os.urandom(len(body)), np.full(24, np.nan).tobytes() + body):
            super()._send(name, kind, wrong, number, ns)
        super()._send(name, kind, body, number + 1, ns)


class Silent(Garbling):
    """Answers no more from its sixth answer on."""

    def _send(self, name: bytes, kind: int, *given: Any) -> None:
        if kind != remote.ANSWER or self.answered < 6:
            PolicyServer._send(self, name, kind, *given)


def holding(folder: Path, address: str, **more: Any) -> dict[str, Any]:
    """Return a workflow with chunks of a server, that holds after an underrun."""
    write_chunks(folder, period=0.02, hold=0.1, underrun="done")
    flow = {"chain": [{"policy": "slow"}, "hold"]}
    return asking(folder, address, rate=100, flow=flow, **more)


def held(values: dict[str, Any], failing: Any = bool) -> None:
    """Run it at real rate; the robot holds its place before an action is older than 0.25 s."""
    ages, targets, said = [], [], list[str]()

    def look() -> None:
        ages.append(float(program.states["action_age"]))
        targets.append(program.states["joint_pos_target"].copy())
        failing(program.states["tick"])

    program = Program(**values, deferred=[lambda: look()])
    report = Runner(program, RunOptions(duration=0.8, warn=said.append)).run()
    assert (report.faults, report.ended) == ([], "duration")
    assert "the flow goes on (chunk.underrun)" in said[-1]
    assert max(ages) <= 0.26  # 8 rows of 20 ms, the last one held for 0.1 s
    np.testing.assert_array_equal(targets[60], targets[-1])
    assert program.states["joint_stiffness"].min() > 0.0


@pytest.mark.parametrize("kind", [Garbling, Silent])
def test_chunks_of_a_server_that_fails_end_in_a_robot_that_stands(tmp_path: Path, kind: Any):
    write_chunks(tmp_path, period=0.02)
    with serving(tmp_path, kind=kind) as made:
        held(holding(tmp_path, made.address))
        assert made.answered >= 6


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_chunks_of_a_server_that_is_gone_end_in_a_robot_that_stands(tmp_path: Path, number: int):
    write_chunks(tmp_path, period=0.02)
    with served(tmp_path) as (process, address):
        held(holding(tmp_path, address), lambda t: t == 20 and process.send_signal(number))


HUGE = [[["obs", "float32", [1 << 40]]], []]


@pytest.mark.parametrize(
    "said",
    [b"", b"\xff", b"{}", b"[[], [], []]", b"[" * 100_000, *(json.dumps(s).encode() for s in (
        HUGE, [[["obs", "what", [1]]], []], [[["obs", "float32", [-5]]], []], [[[1, 2, 3]], []],
        [[["obs", "float32", [1.5]]], [["a", "object", [4]]]],
    ))],
)  # fmt: skip
def test_a_server_that_describes_its_network_wrongly_is_refused(quick: Path, said: bytes):
    class Lying(PolicyServer):
        def _send(self, name: bytes, kind: int, *given: Any) -> None:
            super()._send(name, kind, *((said,) if kind == remote.READY else given))

    with (
        serving(quick, kind=Lying) as made,
        pytest.raises(PolicyError, match="does not say what its network takes and gives; run"),
    ):
        Program(**asking(quick, made.address))


def test_strangers_disturb_nobody(quick: Path, wanted: str):
    """Garbage, cut messages and a flood that takes no answers reach the server beside a robot."""
    with serving(quick) as made, closing(raw(made.address)) as stranger:
        digest, random = made.digest, np.random.default_rng(3)
        for wrong in (os.urandom(32), bytes(32)):
            for kind in (remote.HELLO, remote.QUESTION):
                stranger.send_multipart(remote.packed(wrong, kind))
                assert stranger.poll(5000)
                kind, _, _, theirs, _ = remote.unpacked(stranger.recv_multipart())
                assert (kind, theirs) == (remote.REFUSED, digest)
        size = child.layouts_of(child.tensors_of(json.loads(made._ready)))[0].nbytes
        garbage: list[list[bytes]] = [[os.urandom(int(n))] for n in random.integers(0, 300, 1000)]
        garbage += [[b"UNICONP1" + os.urandom(56), b"?"] for _ in range(1000)]
        garbage += [remote.packed(digest, remote.QUESTION, b"x", n) for n in range(1000)]
        garbage += [remote.packed(digest, remote.READY), [b"two", b"parts", b"more"]]
        questions = [
            remote.packed(digest, remote.QUESTION, os.urandom(size), 1 << n) for n in range(60)
        ]
        for message in (*garbage, *questions * 20):
            if stranger.poll(5, zmq.POLLOUT):
                stranger.send_multipart(message, zmq.NOBLOCK)
        found = run(asking(quick, made.address))
        assert found.faults == []
        assert found.sha256_commands == wanted
        assert made.garbage > 10


def side_by_side(described: Iterable[dict[str, Any]]) -> list[str]:
    """Run programs tick by tick beside each other; return what each sent."""
    with ExitStack() as stack:
        programs = [Program(**each) for each in described]
        runners = [Runner(p, RunOptions(speed="max", warn=lambda _: None)) for p in programs]
        for program in programs:
            stack.callback(program.close)
        for _ in range(20):
            for runner in runners:
                runner.tick(0)
        return [runner.report().sha256_commands for runner in runners]


def test_two_robots_have_memories_of_their_own(quick: Path, server: PolicyServer):
    alone = [run(asking(quick, server.address, commands=c)).sha256_commands for c in ([], RISING)]
    assert alone[0] != alone[1]
    assert side_by_side(asking(quick, server.address, commands=c) for c in ([], RISING)) == alone


@pytest.mark.slow
def test_more_robots_than_the_server_has_arrays_for_take_turns(
    quick: Path, wanted: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(remote_server, "MOST", 1)
    with serving(quick) as made:
        found = side_by_side(asking(quick, made.address) for _ in range(2))
        assert len(made._robots) == 1
        assert found == [wanted] * 2


@pytest.mark.parametrize(
    ("failing", "told"),
    [
        ("nan", "policy slow: the action is not finite: joint 'FR_hip_joint' is nan; no target"),
        ("raise", "its network raised "),
    ],
)
def test_what_goes_wrong_there_is_told_here(tmp_path: Path, failing: Any, told: str):
    write_slow(tmp_path, failing=failing)
    with serving(tmp_path) as made:
        report = run(asking(tmp_path, made.address, commands=RISING), 1.0)
        assert told in report.faults[0]
        assert 10 <= report.ticks < 25
        assert run(asking(tmp_path, made.address), 0.1).faults == []


# -- silence ------------------------------------------------------------------------------------


def test_a_server_that_is_started_anew_is_found_again(quick: Path, wanted: str):
    with ExitStack() as stack:
        made = stack.enter_context(serving(quick))
        program = Program(**asking(quick, made.address, deferred=[lambda: restart()]))

        def restart() -> None:
            if program.states["tick"] == 10:
                stack.close()
                stack.enter_context(serving(quick, made.address))

        found = Runner(program, RunOptions(duration=0.4, speed="max", warn=lambda _: None)).run()
    assert found.faults == []
    assert found.sha256_commands == wanted


@pytest.mark.parametrize("flow", [None, STANDS])
def test_silence_is_a_fault_or_ends_the_policy(quick: Path, flow: Any):
    more = {} if flow is None else {"flow": flow}
    with ExitStack() as stack:
        made = stack.enter_context(serving(quick))
        program = Program(**asking(quick, made.address, deferred=[lambda: stop()], **more))

        def stop() -> None:
            if program.states["tick"] == 10:
                made.stop()

        report = Runner(program, RunOptions(duration=0.8, warn=lambda _: None)).run()
    if flow is None:
        assert "is 0.26 s old, at most 0.25 s are allowed: the server at tcp" in report.faults[0]
        assert report.faults[0].endswith("is too slow, hangs or was stopped (remote.timeout)")
        assert report.ticks < 30
    else:
        assert report.faults == []
        assert report.ended == "duration"
        np.testing.assert_allclose(
            program.states["joint_pos_target"], program.robot.default_joint_pos
        )


@pytest.mark.slow
def test_go2_that_walks_stands_when_the_server_is_silent():
    """At 0.8 m/s, by the flow that the reference shows."""
    walk = {"loop": {"do": {"policy": "walk"}, "until": "action_age > 0.1"}}
    stand = [{"pose": {"to": "stand", "duration": 0.3}}, "hold"]
    flow = {"chain": [{"pose": {"to": "stand", "duration": 1.5}}, walk, *stand]}
    command = {"velocity_command": {"schedule": [[0.0, 0, 0, 0], [2.0, 0.8, 0, 0]]}}
    with ExitStack() as stack:
        made = stack.enter_context(serving("go2_velocity"))
        entry = {"path": "go2_velocity", "remote": {"address": made.address}}
        changed = {"policies.walk": entry, "flow": flow, "commands": [command]}
        program = load_workflow("go2_walk", {**changed, "deferred": [lambda: stop()]})

        def stop() -> None:
            if program.states["tick"] == 225:
                made.stop()

        report = Runner(program, RunOptions(duration=7.0, warn=lambda _: None)).run()
    assert report.faults == []
    assert report.ended == "duration"
    assert not report.fell
    assert report.base_displacement_m is not None
    assert report.base_displacement_m[0] > 0.8
    assert program.states["base_pos_w"][2] > 0.25


@pytest.mark.slow
def test_a_record_of_a_paced_run_is_repeated(quick: Path, server: PolicyServer, tmp_path: Path):
    path = tmp_path / "slow.yaml"
    path.write_text(yaml.safe_dump(asking(quick, server.address, delay=3)), "utf-8")
    record = str(tmp_path / "run")
    for words in (["run", str(path), "--duration", "0.5", "--record", record], ["replay", record]):
        more = ["--verify"] if words[0] == "replay" else []
        command = [sys.executable, "-m", "unicon_ros", *words, *more]
        done = subprocess.run(command, capture_output=True, text=True, env=same_modules())
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("speed", ["real", "max"])
def test_a_server_that_is_killed_or_stopped_is_a_fault(
    quick: Path, monkeypatch: pytest.MonkeyPatch, number: int, speed: Any
):
    monkeypatch.setattr(child, "PATIENCE", 0.3)
    with served(quick) as (process, address):
        program = Program(**asking(quick, address, deferred=[lambda: kill()]))

        def kill() -> None:
            if program.states["tick"] == 20:
                process.send_signal(number)

        options = RunOptions(duration=3.0, speed=speed, warn=lambda _: None)
        begun = time.monotonic()
        report = Runner(program, options).run()
    assert "hangs or was stopped" in report.faults[0]
    assert address in report.faults[0]
    assert report.ticks < 40
    assert time.monotonic() - begun < 3.0


@pytest.mark.slow
def test_a_slow_link_delays_no_tick(quick: Path):
    with serving(quick) as made, closing(SlowLink(made.address, 0.04)) as link:
        ages: list[float] = []
        program = Program(**asking(quick, link.address, timeout=1.0, deferred=[lambda: look()]))

        def look() -> None:
            ages.append(float(program.states["action_age"]))

        report = Runner(program, RunOptions(duration=1.5, warn=lambda _: None)).run()
    assert report.faults == []
    found = report.extra["remote"]["slow"]
    assert 80.0 <= found["round_trip_ms"]["p50"] < 140.0
    assert found["inference_ms"]["p50"] < 20.0
    assert 0.1 <= max(ages) < 0.5
    assert report.blocks["policy"]["p50"] < 5_000.0


@pytest.mark.slow
def test_serve_says_what_a_robot_needs_and_ends_in_order(quick: Path):
    with served(quick) as (process, address):
        assert run(asking(quick, address), 0.2).faults == []
        process.send_signal(signal.SIGINT)
        rest = process.communicate(timeout=20)[0]
        assert process.returncode == 0
        assert "answers  " in rest


@pytest.mark.slow
def test_serve_listens_to_others_with_keys_alone(quick: Path):
    command = [sys.executable, "-m", "unicon_ros", "serve", str(quick), "--bind", "tcp://*:5560"]
    done = subprocess.run(command, capture_output=True, text=True, env=same_modules(), timeout=60)
    assert done.returncode == 1
    assert "--bind tcp://*:5560: other machines reach it; make keys" in done.stderr
