"""Text, Mermaid and SVG of a graph: complete, marked, escaped, and laid out without overlaps."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_core.flow import (
    Blender,
    Block,
    Chain,
    Deferred,
    Every,
    LinearMap,
    Loop,
    Node,
    Stage,
    Switch,
    When,
    Zip,
    critical_path,
    fuse,
)
from unicon_core.policies import ActionSpec, ObservationSpec, ObservationTerm, PolicyContract
from unicon_core.show.svg import CHAR, show_svg
from unicon_core.show.text import data_flow, shortened, show_mermaid, show_text, state_rows
from unicon_core.states import States, standard_states

STATES = States(standard_states(["hip", "thigh", "calf"]), 2)


def block(
    name: str, reads: str = "", writes: str = "", amends: str = "", stage: Any = None
) -> Block:
    return Block(
        name, bool, tuple(reads.split()), tuple(writes.split()), tuple(amends.split()), stage=stage
    )


RECV = block("recv", "", "joint_pos joint_vel base_quat stamp_ns base_ang_vel", stage=Stage.RECV)
POSE = block("pose", "joint_pos", "joint_pos_target")
WALK = block("walk", "joint_pos joint_vel velocity_command", "joint_pos_target")
UNTIL = block('tick > 500 & "x"', "tick")
MODE = block("mode", "tick")
LIMITS = block("joint_limits", "", "", "joint_pos_target", Stage.SAFETY)
SEND = block("send", "joint_pos_target", stage=Stage.SEND)
LOG = block("log <1>", "joint_pos joint_pos_target")


def example() -> Node:
    walk = Loop(WALK, until=UNTIL)
    switch = Switch(MODE, {"go": walk, "stay": POSE}, blend=3, blender=Blender({}))
    return Zip(
        RECV,
        Chain(POSE, switch),
        LIMITS,
        Every(5, When(block("fallen", "base_quat"), LOG)),
        SEND,
        Deferred(block("bridge", "joint_pos")),
    )


FOUND = critical_path(example())


def test_text_draws_the_tree_and_marks_the_critical_path() -> None:
    tree = show_text(FOUND.root, STATES, FOUND.critical).split("\n\n")[0]
    assert re.sub(r" {2,}(reads|writes|amends).*", "", tree).splitlines() == [
        "zip",
        "├─ ● recv",
        "├─ chain",
        "│  ├─ 1: ● pose",
        "│  └─ 2: switch on mode, blended over 3 ticks",
        '│     ├─ go: loop until tick > 500 & "x"',
        "│     │  └─ ● walk",
        "│     └─ stay: ● pose",
        "├─ ● joint_limits",
        "├─ deferred, found not to be part of the command",
        "│  └─ every 5 ticks",
        "│     └─ when fallen",
        "│        └─ log <1>",
        "├─ ● send",
        "└─ deferred",
        "   └─ bridge",
    ]
    assert "writes joint_pos, joint_vel, base_quat, +2" in tree


def test_text_tells_the_states_and_the_layout() -> None:
    text = show_text(FOUND.root, STATES, FOUND.critical)
    layout = STATES.layout
    assert f"17 states × 2 robots, {layout.nbytes} bytes, layout {layout.hash[:12]}" in text
    row = next(line for line in text.splitlines() if line.startswith("joint_pos_target "))
    assert re.split(r" {2,}", row) == [
        "joint_pos_target",
        "2×3",
        "float32",
        "rad",
        "-",
        "pose, walk, joint_limits (amends)",
        "log <1>, send",
        "position target",
    ]
    assert "stamp_ns" in text


def test_every_state_has_its_writers_and_readers() -> None:
    heads, *states = state_rows(example(), STATES)
    rows = {name: dict(zip(heads, (name, *cells))) for name, *cells in states}
    assert list(rows) == list(STATES)
    assert rows["joint_pos"]["writer"] == "recv"
    assert rows["joint_pos"]["readers"] == "pose, walk, log <1>, bridge"
    assert rows["tick"]["readers"] == 'mode, tick > 500 & "x"'
    assert rows["joint_pos_target"]["writer"].endswith("joint_limits (amends)")
    assert (rows["base_pos_w"]["writer"], rows["base_pos_w"]["readers"]) == ("-", "-")


def test_mermaid_has_each_node_its_branches_and_the_data() -> None:
    chart = show_mermaid(FOUND.root, STATES, FOUND.critical)
    lines = [line.strip() for line in chart.splitlines()]
    assert lines[1] == "flowchart TB"
    defined = dict(re.findall(r"^\s+(n\d+)[(\[]+\"(.*?)\"", chart, re.MULTILINE))
    name = {text: place for place, text in reversed(defined.items())}
    assert name["log #lt;1#gt;"]
    assert name["loop until tick #gt; 500 & #quot;x#quot;"]
    assert f'{name["switch on mode, blended over 3 ticks"]} -- "go" --> ' in chart
    assert f'{name["joint_limits"]} -. "joint_pos_target" .-> {name["send"]}' in chart
    assert f'{name["recv"]} -. "joint_pos" .-> {name["bridge"]}' in chart
    used = set(re.findall(r"\bn\d+\b", chart))
    assert used == set(defined)
    (marked,) = re.findall(r"class ([n\d,]+) critical;", chart)
    assert {defined[place] for place in marked.split(",")} >= {"recv", "walk", "send"}
    assert name["bridge"] not in marked.split(",")


def test_data_comes_from_whoever_wrote_last() -> None:
    log, tail = block("log", "joint_pos_target"), block("tail", "joint_pos_target")
    flow = data_flow(Zip(RECV, Deferred(tail), log, Chain(POSE, WALK), LIMITS, SEND))
    assert flow[LIMITS, SEND] == ["joint_pos_target"]
    assert flow[POSE, LIMITS] == flow[WALK, LIMITS] == ["joint_pos_target"]
    assert (POSE, SEND) not in flow
    assert flow[LIMITS, log] == ["joint_pos_target"]  # of the tick before
    assert flow[LIMITS, tail] == ["joint_pos_target"]


def test_data_of_conditional_blocks_may_be_of_before() -> None:
    reader = block("reader", "joint_pos_target")
    flow = data_flow(Zip(POSE, When(block("if"), block("extra", "", "joint_pos_target")), reader))
    assert {source.name for source, to in flow if to is reader} == {"pose", "extra"}


def test_blocks_fused_from_critical_ones_are_critical() -> None:
    copies = []
    for name in ("joint_pos", "joint_vel"):
        linear = LinearMap(STATES[name], STATES[f"{name}_target"])
        made = block(f"copy {name}", name, f"{name}_target")
        copies.append(replace(made, linear=linear, endless=True))
    send = block("send", "joint_pos_target joint_vel_target", stage=Stage.SEND)
    found = critical_path(Zip(RECV, *copies, send))
    root = fuse(found.root, STATES)
    text = show_text(root, STATES, found.critical)
    assert "├─ ● copy joint_pos … copy joint_vel (2 fused)" in text
    assert (
        show_svg(root, STATES, found.critical).count('class="critical"') == 3 + 2 + 1
    )  # with the two that were fused, and the legend
    assert re.findall(r"class (.*) critical;", show_mermaid(root, STATES, found.critical)) == [
        "n1,n2,n3"
    ]


def boxes(svg: str) -> list[tuple[str, float, float, float, float]]:
    root = ET.fromstring(svg)
    return [
        (
            rect.get("class", ""),
            *(float(rect.get(key, "0")) for key in ("x", "y", "width", "height")),  # type: ignore[misc]
        )
        for rect in root.iter("{http://www.w3.org/2000/svg}rect")
    ]


def test_svg_boxes_are_nested_or_apart() -> None:
    svg = show_svg(FOUND.root, STATES, FOUND.critical)
    page, *drawn = boxes(svg)
    assert sum(kind == "critical" for kind, *_ in drawn) == 6 + 1  # and the legend
    for i, (_, x, y, width, height) in enumerate(drawn):
        assert x >= 0
        assert y >= 0
        assert x + width <= page[3]
        assert y + height <= page[4]
        for _, x2, y2, width2, height2 in drawn[i + 1 :]:
            apart = x + width <= x2 or x2 + width2 <= x or y + height <= y2 or y2 + height2 <= y
            inside = x < x2 and y < y2 and x2 + width2 < x + width and y2 + height2 < y + height
            assert apart or inside


def test_svg_text_fits_into_its_box_and_says_everything() -> None:
    svg = show_svg(FOUND.root, STATES, FOUND.critical)
    root = ET.fromstring(svg)
    texts = list(root.iter("{http://www.w3.org/2000/svg}text"))
    words = [text.text or "" for text in texts]
    for name in ("recv", "log <1>", "go", 'loop until tick > 500 & "x"', *STATES):
        assert name in words
    page, *drawn = boxes(svg)
    for text in texts:
        x, y = float(text.get("x", "0")), float(text.get("y", "0"))
        end = x + CHAR * len(text.text or "")
        around = [b for b in drawn if b[1] <= x <= b[1] + b[3] and b[2] <= y <= b[2] + b[4]]
        inner = min(around, key=lambda b: b[3], default=page)
        assert end <= inner[1] + inner[3] + 1


def test_svg_draws_an_arrow_between_the_steps_of_a_chain() -> None:
    assert show_svg(Chain(bool, bool, bool), STATES).count('class="arrow"') == 2


@pytest.mark.parametrize(
    ("names", "short"),
    [
        ((), ""),
        (("a",), "a"),
        (("a", "b", "c"), "a, b, c"),
        (("a", "b", "c", "d"), "a, b, +2"),
    ],
)
def test_long_lists_are_shortened(names: tuple[str, ...], short: str) -> None:
    assert shortened(names, 3) == short


def test_the_tables_of_a_policy_are_part_of_the_text() -> None:
    joints = ("hip", "thigh", "calf")
    ones = np.ones(3, np.float32)
    contract = PolicyContract(
        name="walk",
        path=Path("walk.yaml"),
        model=Path("walk.onnx"),
        period=0.02,
        joints=joints,
        default_joint_pos=0.5 * ones,
        action=ActionSpec(joints, 0.25 * ones, 0.5 * ones),
        stiffness=20.0 * ones,
        damping=ones,
        observation=ObservationSpec((ObservationTerm("qpos", "joint_pos"),)),
        inputs={"observation": "obs"},
        outputs={"action": "actions"},
    )
    parts = show_text(FOUND.root, STATES, policies={"fast walk": contract}).split("\n\n")
    assert parts[-4] == "joints of policy fast walk"
    assert all(joint in parts[-3] for joint in joints)
    assert parts[-2] == "observation of policy fast walk"
    assert "qpos" in parts[-1]
    assert "[0:3]" in parts[-1]
    assert "of policy" not in show_text(FOUND.root, STATES)
