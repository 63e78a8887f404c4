"""What the command depends on, and that putting the rest off changes nothing but its time."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_core.flow import (
    Block,
    Chain,
    Deferred,
    Every,
    Loop,
    Node,
    Stage,
    Zip,
    blocks_of,
    children_of,
    compile_graph,
)
from unicon_core.flow.critical_path import CriticalPath, critical_path


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
        options.pop("tick", bool),
        tuple(reads.split()),
        tuple(writes.split()),
        tuple(amends.split()),
        stage=stage,
        **options,
    )


RECV = block("recv", "", "joint_pos joint_vel", stage=Stage.RECV)
POLICY = block("policy", "joint_pos command", "target")
LIMITS = block("limits", "", "", "target", stage=Stage.SAFETY)
SEND = block("send", "target", stage=Stage.SEND)


def names(blocks: Any) -> set[str]:
    return {block.name for block in blocks}


def put_off(node: Node) -> list[str]:
    """Return the names of the blocks that were put off, in order."""
    if isinstance(node, Deferred) and node.ends:
        return [block.name for block in blocks_of(node)]
    return [name for child in children_of(node) for name in put_off(child)]


def find(*parts: Node) -> CriticalPath:
    return critical_path(Zip(*parts))


def test_a_recorder_before_send_is_put_off() -> None:
    recorder = block("recorder", "joint_pos target")
    found = find(RECV, recorder, POLICY, SEND)
    # it would read the target before the policy has written it
    assert not put_off(found.root)
    assert recorder not in found.critical
    found = find(RECV, POLICY, recorder, SEND)
    assert put_off(found.root) == ["recorder"]
    assert names(found.critical) == {"recv", "policy", "send"}


def test_what_send_needs_through_others_is_critical() -> None:
    chain = [block(f"b{i}", f"s{i}", f"s{i + 1}") for i in range(4)]
    send = block("send", "s4", stage=Stage.SEND)
    found = find(RECV, *chain, send)
    assert names(found.critical) == {"recv", "b0", "b1", "b2", "b3", "send"}
    assert not put_off(found.root)


def test_a_writer_behind_its_reader_is_critical_through_the_next_tick() -> None:
    feedback = block("feedback", "joint_vel", "command")
    assert feedback in find(RECV, POLICY, feedback, SEND).critical


def test_a_chain_of_bystanders_is_put_off_in_order() -> None:
    derive = block("derive", "joint_pos", "energy")
    log = block("log", "energy")
    found = find(RECV, derive, POLICY, log, SEND)
    assert put_off(found.root) == ["derive", "log"]


def test_a_bystander_stays_when_a_kept_one_reads_what_it_writes() -> None:
    derive = block("derive", "joint_pos", "energy")
    log = block("log", "energy joint_vel")
    clobber = block("clobber", "joint_pos", "joint_vel", stage=Stage.SAFETY)
    found = find(RECV, derive, log, clobber, SEND)
    assert not put_off(found.root)
    assert put_off(find(RECV, derive, log, SEND).root) == ["derive", "log"]


def test_undeclared_blocks_and_blocks_of_a_fixed_stage_stay() -> None:
    plain, keyboard = block("plain"), block("keyboard", "", "keys")
    stop = block("stop", "joint_pos", stage=Stage.SAFETY)
    found = find(RECV, plain, keyboard, stop, POLICY, SEND)
    assert not put_off(found.root)
    assert not {plain, keyboard} & found.critical
    assert stop in found.critical


def test_explicit_order_and_explicit_deferred_win() -> None:
    early, late = block("early", "joint_pos"), block("late", "joint_pos")
    tree = Zip(RECV, Deferred(early), POLICY, SEND, late)
    found = critical_path(tree)
    assert found.root is tree
    assert not {early, late} & found.critical


def test_an_explicit_deferred_before_it_is_not_overtaken() -> None:
    explicit, after = block("explicit", "joint_pos", "x"), block("after", "x")
    assert not put_off(find(RECV, Deferred(explicit), after, SEND).root)


def test_bystanders_inside_nested_zips_and_loops_are_found() -> None:
    log = block("log", "joint_pos")
    inner = Zip(POLICY, Every(3, log))
    found = critical_path(Zip(Loop(Zip(RECV, inner, SEND), until=block("end", "tick")), bool))
    assert put_off(found.root) == ["log"]
    outer = found.root
    assert isinstance(outer, Zip)
    assert isinstance(outer.children[0], Loop)
    assert isinstance(inner.children[1], Every)  # the given tree stays as it is


def test_a_block_that_stands_twice_stays() -> None:
    log = block("log", "joint_pos")
    assert not put_off(find(RECV, log, POLICY, log, SEND).root)


def test_without_send_nothing_moves() -> None:
    tree = Zip(RECV, block("log", "joint_pos"))
    found = critical_path(tree)
    assert found.root is tree
    assert not found.critical
    chain = Chain(Zip(RECV, block("log", "joint_pos"), SEND), bool)
    assert critical_path(chain).root is chain


def test_what_is_put_off_still_ends_the_graph_in_its_tick() -> None:
    calls = iter([False, False, True])
    log = block("log", "joint_pos", tick=lambda: next(calls))
    found = find(RECV, log, SEND)
    assert put_off(found.root) == ["log"]
    graph = compile_graph(found.root)
    assert [(graph.step(), graph.deferred()) for _ in range(3)] == [
        (False, False),
        (False, False),
        (False, True),
    ]


STATES = "abcdef"
some = st.lists(st.sampled_from(STATES), max_size=2, unique=True).map(tuple)
described = st.lists(
    st.tuples(
        some,
        some,
        some,
        st.sampled_from([None, None, None, Stage.SAFETY]),
        st.sampled_from(["block", "block", "block", "deferred", "every", "zip"]),
        st.integers(0, 12),
    ),
    min_size=1,
    max_size=8,
)


def run(parts: Any, after: int, move: bool) -> tuple[Any, CriticalPath]:
    """Run five ticks; return what each block saw in each of its calls, and when it ended."""
    memory = dict.fromkeys(STATES, 1)
    seen: dict[str, list[Any]] = {}

    def make(i: int, reads: Any, writes: Any, amends: Any, stage: Any, ends: int) -> Block:
        log = seen.setdefault(f"p{i}", [])

        def tick() -> bool:
            log.append([memory[name] for name in (*reads, *amends)])
            for name in (*writes, *amends):
                memory[name] = hash((i, name, len(log), *log[-1])) % 10_007
            return len(log) == ends

        return Block(f"p{i}", tick, reads, writes, amends, stage=stage)

    nodes: list[Node] = []
    for i, (reads, writes, amends, stage, wrap, ends) in enumerate(parts):
        made: Node = make(i, reads, writes, amends, stage, ends)
        if wrap == "deferred":
            made = Deferred(made)
        elif wrap == "every":
            made = Every(2, made)
        elif wrap == "zip":
            made = Zip(made, Deferred(make(i + 50, reads, writes, (), "", 0)))
        nodes.append(made)
    send = make(99, ("a", "b"), (), (), "send", 0)
    nodes.insert(len(nodes) - min(after, len(nodes)), send)
    found = critical_path(Zip(*nodes))
    graph = compile_graph(found.root if move else Zip(*nodes))
    ended = None
    for tick in range(5):
        done = graph.step()
        if graph.deferred() or done:
            ended = tick
            break
    return (seen, ended, memory), found


@settings(max_examples=400)
@given(described, st.integers(0, 2))
def test_every_block_sees_the_same_values_as_without_putting_off(parts: Any, after: int) -> None:
    assert run(parts, after, True)[0] == run(parts, after, False)[0]
