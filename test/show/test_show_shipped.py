"""`unicon show` on every workflow that is shipped: text, source, Mermaid and SVG."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
from pages import read_page

from unicon_core.flow import blocks_of, compile_graph
from unicon_core.show.svg import show_svg
from unicon_core.show.text import ENTITIES, show_mermaid, show_text
from unicon_core.workflow import Program, load_document, load_workflow, workflow_names
from unicon_ros.cli.main import main

QUICK = ("go2_walk", "go2_desk", "g1_vr")
"""The smallest, one of several processes and the largest; the slow tests take all."""

WORKFLOWS = [
    name if name in QUICK else pytest.param(name, marks=pytest.mark.slow)
    for name in workflow_names()
]


@pytest.fixture(scope="module", params=WORKFLOWS)
def workflow(request: pytest.FixtureRequest) -> Iterator[Program]:
    text = load_document(request.param).path.read_text(encoding="utf-8")
    if "assets:" in text:
        request.getfixturevalue("assets")
        request.getfixturevalue("at_hand")(request.param)
    loaded = load_workflow(request.param)
    yield loaded
    loaded.close()


def test_text_names_every_block_state_and_table(workflow: Program) -> None:
    text = show_text(
        workflow.root,
        workflow.states,
        workflow.critical,
        robot=workflow.robot,
        policies=workflow.policies,
    )
    for block in blocks_of(workflow.root):
        assert block.name in text
    for name in workflow.states:
        assert re.search(rf"\b{name}\b", text)
    for contract in workflow.policies.values():
        for joint in contract.joints:
            assert joint in text
        for term in contract.terms:
            assert term.name in text


def test_mermaid_has_a_node_for_every_block_and_balanced_subgraphs(workflow: Program) -> None:
    drawn = show_mermaid(workflow.root, workflow.states, workflow.critical)
    lines = [line for line in drawn.splitlines() if not line.startswith("%%")]
    assert lines[0].startswith(("flowchart", "graph"))
    opened = sum(line.strip().startswith("subgraph") for line in lines)
    assert opened == sum(line.strip() == "end" for line in lines)
    text = "\n".join(lines)
    for block in blocks_of(workflow.root):
        assert block.name.split("(")[0].strip().translate(ENTITIES) in text


def test_svg_is_well_formed_and_says_every_block(workflow: Program) -> None:
    root = ElementTree.fromstring(show_svg(workflow.root, workflow.states, workflow.critical))
    assert root.tag.endswith("svg")
    said = " ".join(text for element in root.iter() for text in [element.text or ""])
    for block in blocks_of(workflow.root):
        assert block.name in said


def test_source_calls_every_block_and_compiles(workflow: Program) -> None:
    source = compile_graph(workflow.root).source
    compile(source, "<shown>", "exec")
    for block in blocks_of(workflow.root):
        if not block.inline:
            clean = "".join(c if c.isalnum() and c.isascii() else "_" for c in block.name)
            assert re.search(rf"\bb\d+_{clean}\(\)", source)


@pytest.mark.parametrize("name", WORKFLOWS)
def test_the_command_shows_it_in_every_form(
    name: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if "assets:" in load_document(name).path.read_text(encoding="utf-8"):
        request.getfixturevalue("assets")
        request.getfixturevalue("at_hand")(name)
    picture = tmp_path / "graph.svg"
    page = tmp_path / "graph.html"
    for form in ([], ["--source"], ["--mermaid"], ["--svg", str(picture)], ["--html", str(page)]):
        assert main(["show", name, *form]) == 0
        assert capsys.readouterr().out.strip()
    assert ElementTree.parse(picture).getroot().tag.endswith("svg")
    read_page(page.read_text("utf-8"))
