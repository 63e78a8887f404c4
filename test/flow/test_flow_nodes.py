"""What each node means, one expected tick table per fact; and the errors of wrong nodes."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.flow import (
    Blender,
    Block,
    Chain,
    Deferred,
    Every,
    Loop,
    Node,
    Switch,
    When,
    Zip,
    as_block,
    blocks_of,
    compile_graph,
)
from unicon_core.flow.block import Stage
from unicon_core.flow.compiler import GROUP


class Recorder:
    """Makes blocks that note their calls; `ticks` gives the notes tick by tick."""

    def __init__(self) -> None:
        self.notes = ""

    def block(self, letter: str, ends: int = 0) -> Block:
        """Block that is done at its `ends`-th call after each reset; never with 0."""
        calls = 0

        def tick() -> bool:
            nonlocal calls
            self.notes += letter
            calls += 1
            return calls == ends

        def reset() -> None:
            nonlocal calls
            self.notes += f"({letter})"
            calls = 0

        return Block(letter, tick, reset=reset)

    def ticks(self, root: Node, number: int) -> str:
        """Run and return the notes; `|` ends a tick, `!` stands where the graph was done."""
        graph = compile_graph(root)
        table = []
        for _ in range(number):
            self.notes = ""
            done = graph.step()
            ended = graph.deferred()
            table.append(self.notes + "!" * (done + ended))
        return " ".join(table)


@pytest.fixture
def r() -> Recorder:
    return Recorder()


def test_zip_steps_all_and_ends_with_the_first(r: Recorder) -> None:
    root = Zip(r.block("a"), r.block("b", 2), r.block("c"))
    assert r.ticks(root, 3) == "abc ab(b)c(a)(c)! abc"


def test_chain_takes_the_next_child_in_the_next_tick(r: Recorder) -> None:
    assert r.ticks(Chain(r.block("a", 2), r.block("b", 1)), 4) == "a a(a) b(b)! a"


def test_loop_asks_its_predicate_after_the_step(r: Recorder) -> None:
    assert r.ticks(Loop(r.block("a"), until=r.block("p", 2)), 3) == "ap ap(a)(p)! ap"


def test_loop_does_not_ask_when_the_child_has_ended(r: Recorder) -> None:
    assert r.ticks(Loop(r.block("a", 2), until=r.block("p")), 3) == "ap a(a)(p)! ap"


def test_loop_without_a_predicate_ends_with_its_child(r: Recorder) -> None:
    assert r.ticks(Loop(r.block("a", 2)), 3) == "a a(a)! a"


def test_every_steps_in_the_first_of_n_ticks_and_starts_anew_when_done(r: Recorder) -> None:
    assert r.ticks(Every(3, r.block("a", 2)), 6) == "a   a(a)! a "


def test_when_steps_only_while_the_predicate_holds(r: Recorder) -> None:
    answers = iter([False, True, False, True])
    assert r.ticks(When(lambda: next(answers), r.block("a", 2)), 4) == " a  a(a)!"


def test_switch_resets_the_outgoing_case(r: Recorder) -> None:
    keys = iter(["stand", "walk", "walk", "stand", 1])
    root = Switch(lambda: next(keys), {"stand": r.block("s"), "walk": r.block("w")})
    assert r.ticks(root, 5) == "s (s)w w (w)s (s)w"


def test_switch_is_done_with_its_case(r: Recorder) -> None:
    root = Switch(lambda: 0, {"stand": r.block("s", 2), "walk": r.block("w")})
    assert r.ticks(root, 3) == "s s(s)! s"


@pytest.mark.parametrize("key", [1, True, np.int64(1), np.bool_(True), np.array(1), "walk"])
def test_a_case_is_meant_by_its_name_number_or_a_comparison(key: object) -> None:
    assert Switch(lambda: 0, {"stand": bool, "walk": bool}).index(key) == 1


def test_switch_blends_linearly_from_the_last_command_sent() -> None:
    command = np.zeros(1, np.float32)
    keys = iter([0, 0, 1, 1, 1, 1, 1])
    sent = []

    def write(value: float) -> bool:
        command[0] = value
        return False

    root = Zip(
        Switch(
            lambda: next(keys),
            {"a": lambda: write(0.0), "b": lambda: write(8.0)},
            blend=3,
            blender=Blender({"joint_pos_target": command}),
        ),
        lambda: sent.append(float(command[0])),
    )
    graph = compile_graph(root)
    for _ in range(7):
        graph.step()
    assert sent == [0.0, 0.0, 2.0, 4.0, 6.0, 8.0, 8.0]


def test_a_blend_is_the_same_where_the_case_writes_in_every_second_tick_only() -> None:
    command = np.zeros(1, np.float32)
    keys = iter([0, *[1] * 8])
    sent = []

    def rise() -> bool:
        command[0] += 8.0  # on its own command of two ticks ago, not on a mixed one
        return False

    def stay() -> bool:
        return False

    switch = Switch(
        lambda: next(keys),
        {"stay": stay, "rise": Every(2, rise)},
        blend=3,
        blender=Blender({"joint_pos_target": command}),
    )
    graph = compile_graph(Zip(switch, lambda: sent.append(float(command[0]))))
    for _ in range(7):
        graph.step()
    assert sent == [0.0, 2.0, 4.0, 12.0, 16.0, 24.0, 24.0]


def test_a_change_during_a_blend_starts_from_the_blended_command() -> None:
    command = np.zeros(1, np.float32)
    keys = iter([0, 1, 0, 0])
    sent = []

    def write(value: float) -> bool:
        command[0] = value
        return False

    switch = Switch(
        lambda: next(keys),
        {"a": lambda: write(0.0), "b": lambda: write(8.0)},
        blend=1,
        blender=Blender({"joint_pos_target": command}),
    )
    graph = compile_graph(Zip(switch, lambda: sent.append(float(command[0]))))
    for _ in range(4):
        graph.step()
    assert sent == [0.0, 4.0, 2.0, 0.0]


def test_deferred_runs_after_the_step_and_does_not_end_its_parent(r: Recorder) -> None:
    root = Zip(Deferred(r.block("d", 1)), r.block("a", 3))
    assert r.ticks(root, 3) == "ad(d) ad(d) a(a)(d)d(d)!"


def test_deferred_in_a_chain_is_due_only_where_the_chain_stands(r: Recorder) -> None:
    root = Chain(r.block("a", 2), Zip(Deferred(r.block("d")), r.block("b")))
    assert r.ticks(root, 4) == "a a(a) bd bd"


def test_deferred_that_ends_ends_the_graph_in_the_same_tick(r: Recorder) -> None:
    root = Zip(Deferred(r.block("d", 2), ends=True), r.block("a"))
    assert r.ticks(root, 3) == "ad ad(d)(a)(d)! ad"


def test_trace_stamps_rise_and_are_zero_where_nothing_ran() -> None:
    root = Zip(lambda: False, Every(2, lambda: False), Deferred(lambda: False))
    graph = compile_graph(root, trace=True)
    assert graph.deferred_blocks == {2}
    for ran in (True, False):
        graph.step()
        graph.deferred()
        start, tail, first, every, deferred = graph.stamps.tolist()
        assert (every > 0) == ran
        assert start <= first <= (every or first) <= tail <= deferred


def test_groups_of_blocks_share_the_stamp_of_the_last() -> None:
    blocks = [Block(f"b{i}", lambda: False) for i in range(GROUP + 3)]
    graph = compile_graph(Zip(*blocks, Deferred(blocks[0]), Deferred(blocks[1])), trace=True)
    assert [len(group) for group in graph.groups] == [GROUP, 3, 2]
    assert [i for group in graph.groups for i in group] == list(range(GROUP + 5))
    graph.step()
    graph.deferred()
    assert graph.stamps.all()
    graph.watch(False)
    for _ in range(2):
        graph.step()
        graph.deferred()
        stamps = graph.stamps[[1 + GROUP, 4 + GROUP]]
        assert graph.stamps.nonzero()[0].tolist() == [1 + GROUP, 4 + GROUP]
        assert stamps[0] <= stamps[1]  # the last group ends with the tick, and has none
        graph.stamps[:] = 0
    graph.watch(True)
    graph.step()
    graph.deferred()
    assert graph.stamps.all()


def test_without_trace_there_are_no_stamps() -> None:
    graph = compile_graph(Zip(lambda: False))
    assert graph.stamps.size == 0
    assert "now" not in graph.source


def test_inline_names_of_two_blocks_do_not_collide() -> None:
    seen: list[int] = []

    def inline(value: int) -> Block:
        return Block(
            "f",
            print,
            inline="put(value)",
            inline_names={"put": seen.append, "value": value},
        )

    compile_graph(Zip(inline(1), inline(2))).step()
    assert seen == [1, 2]


@pytest.mark.parametrize("inline", ["note('text')", "note.walk()", "print(note)", "[note][0]"])
def test_inline_code_is_numbers_and_bound_names_only(inline: str) -> None:
    block = Block("f", bool, inline=inline, inline_names={"note": bool})
    with pytest.raises(RuntimeError, match="generated code is refused"):
        compile_graph(block)


def test_the_source_is_flat_code() -> None:
    def recv() -> None: ...
    def policy() -> None: ...

    source = compile_graph(Zip(recv, Zip(policy, Chain(Every(2, recv), policy)))).source
    assert source.count("def ") == 5
    assert "_policy()" in source


def test_blocks_stand_in_order_of_calling_each_once() -> None:
    a, b, p = (Block(name, bool) for name in "abp")
    assert blocks_of(Zip(When(p, a), Loop(b, until=p), a)) == [p, a, b]


def test_attributes_of_a_callable_become_the_block() -> None:
    class Recv:
        name = "recv"
        reads = "stamp_ns"
        writes = ("joint_pos", "joint_vel")
        stage = Stage.RECV
        endless = True

        def __call__(self) -> bool:
            return False

        def reset(self) -> None: ...

    recv = Recv()
    block = as_block(recv, where="w.yaml:3")
    assert (block.name, block.reads, block.writes) == ("recv", ("stamp_ns",), recv.writes)
    assert (block.stage, block.where, block.reset) == (Stage.RECV, "w.yaml:3", recv.reset)
    assert block.endless


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Zip(where="w.yaml:7"), "w.yaml:7: zip: no blocks; give at least one"),
        (lambda: Chain(), "chain: no blocks; give at least one"),
        (
            lambda: Every(0, bool, where="w.yaml:2"),
            "w.yaml:2: every: n is 0; give a whole number of ticks >= 1",
        ),
        (lambda: Every(True, bool), "every: n is True; give a whole number of ticks >= 1"),
        (lambda: Switch(int, {}), "switch: no cases; give at least one, as name: block"),
        (
            lambda: Switch(int, {"a": bool}, blend=3),
            "switch: blend needs a blender (Blender(states))",
        ),
        (
            lambda: Switch(int, {"a": bool}, blend=-1),
            "switch: blend is -1; give a whole number of ticks >= 0",
        ),
        (
            lambda: Zip(3, where="w.yaml:9"),
            "w.yaml:9: block 3 is a int; a block is a function without parameters that returns "
            "a bool",
        ),
        (
            lambda: Switch(int, {"a": bool, "b": bool}).index("c"),
            "switch: no case 'c'; cases: a, b",
        ),
        (lambda: Switch(int, {"a": bool}).index(1), "switch: no case 1; cases: a"),
        (
            lambda: Switch(int, {"a": bool}).index(np.bool_(True)),
            "switch: no case np.True_; cases: a",
        ),
        (lambda: Switch(int, {"a": bool}).index(None), "switch: no case None; cases: a"),
    ],
)
def test_wrong_nodes_get_a_clear_line(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(WorkflowError) as caught:
        make()
    assert str(caught.value) == message
