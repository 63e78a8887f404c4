"""What the graph check finds, with the exact line, and what it rightly lets pass."""

from __future__ import annotations

from typing import Any

import pytest

from unicon_base.errors import WorkflowError
from unicon_core.flow import (
    Block,
    Chain,
    Deferred,
    Every,
    Loop,
    Node,
    Stage,
    Switch,
    When,
    Zip,
    as_block,
)
from unicon_core.flow.block import LinearMap
from unicon_core.flow.checks import check_graph, raise_first
from unicon_core.flow.critical_path import Finding
from unicon_core.states import States, StateSpec, standard_states

NAMES = ["hip", "thigh", "calf"]
STATES = States(
    {
        **standard_states(NAMES),
        "phase": StateSpec((2,)),
        "height": StateSpec((3,), unit="m", frame="world"),
        "degrees": StateSpec((3,), unit="deg"),
        "count": StateSpec((3,), "int64"),
        "tip": StateSpec((3,), unit="m", frame="base"),
        "set_point": StateSpec((3,), initial=1.0),
    }
)


def block(
    name: str,
    reads: str = "",
    writes: str = "",
    amends: str = "",
    stage: Any = None,
    **options: Any,
) -> Block:
    return Block(
        name,
        bool,
        tuple(reads.split()),
        tuple(writes.split()),
        tuple(amends.split()),
        stage=stage,
        **options,
    )


def endless(name: str) -> Block:
    return block(name, endless=True)


RECV = block("recv", "", "joint_pos joint_vel base_quat stamp_ns", stage=Stage.RECV)
POLICY = block("policy", "joint_pos velocity_command", "joint_pos_target", where="w.yaml:8")
SEND = block("send", "joint_pos_target", stage=Stage.SEND)
GIVEN = ("velocity_command", "tick")


def found(*parts: Node, given: Any = GIVEN) -> list[str]:
    return [str(finding) for finding in check_graph(Zip(*parts), STATES, given=given)]


def test_a_sound_graph_has_no_findings() -> None:
    limits = block("joint_limits", "", "", "joint_pos_target", stage=Stage.SAFETY)
    pose = block("pose", "joint_pos", "joint_pos_target")
    flow = Chain(pose, Switch(block("mode", "tick"), {"walk": POLICY, "stand": pose}))
    recorder = Deferred(block("recorder", " ".join(STATES)))
    assert found(RECV, flow, limits, SEND, recorder) == []


def test_an_unknown_state_comes_alone_with_alternatives() -> None:
    wrong = block("gait", "joint_poz", "phase", where="w.yaml:3")
    lines = found(wrong, block("late", "phase"), POLICY)
    assert len(lines) == 1
    assert lines[0].startswith(
        "w.yaml:3: block 'gait' reads 'joint_poz', which is not a state; did you mean 'joint_pos'? "
        "known: base_ang_vel, "
    )
    assert lines[0].endswith("; or declare it under 'states:'")


def test_unknown_states_are_found_in_all_that_a_block_declares() -> None:
    wrong = block("b", "r", "w", "a", expects={"e": {"unit": "m"}})
    words = [line.split("; ")[0] for line in found(wrong)]
    assert words == [
        f"block 'b' {word} '{word[0]}', which is not a state"
        for word in ("reads", "writes", "amends", "expects")
    ]


def test_a_state_that_nobody_writes() -> None:
    assert found(RECV, POLICY, SEND, given=()) == [
        "w.yaml:8: block 'policy' reads 'velocity_command', which no block writes; put a block "
        "before it that writes 'velocity_command'"
    ]


def test_a_state_read_before_its_writer() -> None:
    clock = block("clock", "", "phase")
    reader = block("reader", "phase")
    assert found(RECV, reader, clock) == [
        "block 'reader' reads 'phase' before 'clock' has written it; put it behind 'clock'"
    ]
    assert found(RECV, clock, reader) == []


def test_amending_needs_a_writer_before() -> None:
    limits = block("limits", "", "", "joint_pos_target", stage=Stage.SAFETY)
    assert found(RECV, limits, POLICY, SEND) == [
        "block 'limits' amends 'joint_pos_target' before 'policy' has written it; put it behind "
        "'policy'"
    ]


@pytest.mark.parametrize(
    "root",
    [
        Chain(block("first", "", "phase"), block("second", "phase")),
        Loop(block("do", "", "phase"), until=block("until", "phase")),
        Zip(Chain(bool, block("later", "phase")), block("clock", "", "phase")),
        Zip(When(bool, block("sometimes", "phase")), block("clock", "", "phase")),
        Switch(lambda: 0, {"a": block("a", "phase"), "b": block("b", "", "phase")}),
        block("feedback", "phase", "phase"),
        block("neutral", "set_point"),
        Zip(Deferred(block("observer", "phase"))),
        When(block("chooser", "", "phase"), block("chosen", "phase")),
        Every(2, Zip(block("clock", "", "phase"), block("reader", "phase"))),
    ],
)
def test_what_may_have_been_written_before_is_no_finding(root: Node) -> None:
    assert found(root) == []


@pytest.mark.parametrize(
    "root",
    [
        Chain(block("reader", "phase"), block("clock", "", "phase")),
        Loop(block("reader", "phase"), until=block("clock", "", "phase")),
        When(block("reader", "phase"), block("clock", "", "phase")),
        Switch(block("reader", "phase"), {"a": block("clock", "", "phase")}),
        Zip(Every(3, block("reader", "phase")), block("clock", "", "phase")),
        Zip(Loop(Chain(block("reader", "phase"), bool)), block("clock", "", "phase")),
    ],
)
def test_what_cannot_have_been_written_before_is_found_everywhere(root: Node) -> None:
    assert found(root) == [
        "block 'reader' reads 'phase' before 'clock' has written it; put it behind 'clock'"
    ]


def test_two_writers_of_a_tick() -> None:
    other = block("sway", "joint_pos", "joint_pos_target", where="w.yaml:9")
    assert found(RECV, POLICY, other, SEND) == [
        "w.yaml:9: block 'sway' writes 'joint_pos_target' in the same tick as 'policy'; a state "
        "has one writer: remove one, declare the second as one that amends, or let a chain or "
        "switch choose"
    ]


A, B = block("a", "", "phase"), block("b", "", "phase")


@pytest.mark.parametrize(
    "root",
    [
        Chain(A, B),
        Switch(lambda: 0, {"a": A, "b": B}),
        Zip(When(bool, A), When(bool, B)),
        Zip(A, block("c", "", "", "phase")),
        Zip(A, A),
        Chain(Zip(A, bool), Every(2, B)),
    ],
)
def test_writers_that_exclude_each_other_are_no_finding(root: Node) -> None:
    assert found(root) == []


@pytest.mark.parametrize(
    "root",
    [
        Zip(A, B),
        Zip(A, When(bool, B)),
        Zip(Chain(A, bool), Chain(bool, B)),
        Zip(A, Every(2, B)),
        Loop(A, until=B),
        When(A, B),
        Switch(A, {"b": B, "c": bool}),
        Zip(A, Deferred(B)),
        Zip(Switch(lambda: 0, {"a": A, "c": bool}), B),
    ],
)
def test_writers_that_meet_are_found(root: Node) -> None:
    assert [line.split(";")[0] for line in found(root)] == [
        "block 'b' writes 'phase' in the same tick as 'a'"
    ]


def test_a_command_written_behind_send() -> None:
    late = block("sway", "joint_pos", "", "joint_pos_target", where="w.yaml:12")
    expected = [
        "w.yaml:12: block 'sway' writes 'joint_pos_target' behind 'send': it would leave a tick "
        "late; put it before 'send', not into 'deferred'"
    ]
    assert found(RECV, POLICY, SEND, late) == expected
    assert found(RECV, POLICY, Deferred(late), SEND) == expected
    assert found(RECV, POLICY, SEND, Deferred(Every(2, late))) == expected
    assert found(RECV, POLICY, late, SEND) == []
    assert found(RECV, POLICY, SEND, block("log", "joint_pos_target", "phase")) == []


def test_a_safety_block_behind_send() -> None:
    stop = block("tilt_stop", "joint_pos", stage=Stage.SAFETY, where="w.yaml:12")
    expected = [
        "w.yaml:12: safety block 'tilt_stop' runs behind 'send': the motors have the command by "
        "then; put it before 'send', not into 'deferred'"
    ]
    assert found(RECV, POLICY, SEND, stop) == expected
    assert found(RECV, POLICY, Deferred(stop), SEND) == expected
    assert found(RECV, POLICY, stop, SEND) == []


def test_a_send_in_one_branch_is_not_sent_for_the_others() -> None:
    stop = block("stop", "joint_pos", stage=Stage.SAFETY)
    one = Switch(lambda: 0, {"a": Zip(POLICY, SEND), "b": bool})
    assert found(RECV, one, stop) == []
    both = Switch(lambda: 0, {"a": Zip(POLICY, SEND), "b": Zip(POLICY, SEND)})
    assert len(found(RECV, both, stop)) == 1
    assert found(RECV, When(bool, Zip(POLICY, SEND)), stop) == []


def test_a_block_behind_one_that_never_ends() -> None:
    behind = Zip(block("lie_down", where="w.yaml:7"), bool)
    assert found(Chain(endless("hold"), behind)) == [
        "w.yaml:7: block 'lie_down' can never be reached: 'hold' before it in the chain is never "
        "done; run both in a zip, or give 'hold' an end: loop: {do: …, until: …}"
    ]


def test_a_loop_that_can_never_end_where_something_waits_for_it() -> None:
    loop = Loop(Zip(endless("walk"), Deferred(bool)), where="w.yaml:5")
    expected = [
        "w.yaml:5: loop of 'walk' can never end, and 'lie_down' stands behind it in the chain; "
        "give it an until:, or put it last"
    ]
    assert found(Chain(loop, block("lie_down"))) == expected
    assert found(Chain(bool, Zip(Every(2, loop)), block("lie_down"), bool)) == expected
    assert found(Chain(bool, loop)) == []
    assert found(loop) == []


@pytest.mark.parametrize(
    "first",
    [
        block("plain"),
        Loop(endless("walk"), until=bool),
        Loop(block("plain")),
        Zip(endless("walk"), block("plain")),
        Switch(lambda: 0, {"a": endless("walk"), "b": block("plain")}),
        When(bool, block("plain")),
        Chain(block("plain"), block("plain")),
    ],
)
def test_what_may_end_is_no_finding(first: Node) -> None:
    assert found(Chain(first, block("behind"))) == []


def test_a_function_annotated_to_return_none_is_endless() -> None:
    def walk() -> None: ...
    def wait() -> bool:
        return False

    class Policy:
        stage: Stage | None = None

        def __call__(self) -> None: ...

    assert [as_block(each).endless for each in (walk, wait, Policy(), bool, lambda: None)] == [
        True,
        False,
        True,
        False,
        False,
    ]


def copy_block(source: str, target: str, **options: Any) -> Block:
    linear = LinearMap(
        STATES[source], STATES[target], source_name=source, target_name=target, **options
    )
    return Block("copy", linear, (source,), (target,), linear=linear, where="w.yaml:4")


def test_a_copy_between_units_or_frames() -> None:
    given = ("joint_pos", "height")
    assert found(copy_block("joint_pos", "degrees"), given=given) == [
        "w.yaml:4: block 'copy' copies 'joint_pos' (unit rad) into 'degrees' (unit deg); give a "
        "scale that converts it, or both states one unit"
    ]
    assert found(copy_block("joint_pos", "degrees", scale=57.29578), given=given) == []
    assert found(copy_block("height", "tip"), given=given) == [
        "w.yaml:4: block 'copy' copies 'height' (frame world) into 'tip' (frame base); rotate it "
        "with a block of its own, or give both states one frame"
    ]


def test_a_copy_between_types() -> None:
    assert found(copy_block("joint_pos", "count"), given=("joint_pos",)) == [
        "w.yaml:4: block 'copy' copies 'joint_pos' (dtype float32) into 'count' (dtype int64); "
        "give both states one dtype"
    ]


@pytest.mark.parametrize(
    ("key", "value", "line"),
    [
        ("shape", (12,), "shape (12,), and it has (3,); declare the state with shape: (12,)"),
        (
            "dtype",
            "float64",
            "dtype float64, and it has float32; declare the state with dtype: float64",
        ),
        ("unit", "deg", "unit deg, and it has rad; declare the state with unit: deg"),
        ("frame", "base", "frame base, and it has ''; declare the state with frame: base"),
    ],
)
def test_a_state_that_is_not_as_expected(key: str, value: Any, line: str) -> None:
    expecting = block("policy", "joint_pos", expects={"joint_pos": {key: value}})
    assert found(expecting, given=("joint_pos",)) == [
        f"block 'policy' expects 'joint_pos' with {line}, or map another one to it"
    ]


def test_expectations_come_from_the_callable() -> None:
    class Policy:
        reads = ("joint_pos",)
        expects = {"joint_pos": {"shape": (3,), "unit": "rad"}}  # noqa: RUF012

        def __call__(self) -> None: ...

    made = as_block(Policy())
    assert made.expects == Policy.expects
    assert found(made, given=("joint_pos",)) == []


def test_the_build_stops_at_the_first_finding() -> None:
    raise_first([])
    with pytest.raises(WorkflowError) as caught:
        raise_first([Finding("loop", "is wrong", "mend it", "w.yaml:1"), Finding("b", "c", "d")])
    assert str(caught.value) == "w.yaml:1: loop is wrong; mend it"
    with pytest.raises(WorkflowError) as caught:
        raise_first([Finding("loop", "is wrong", "mend it")])
    assert str(caught.value) == "loop is wrong; mend it"
