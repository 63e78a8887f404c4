"""The workflow of a replay: one that is named, or the one in the record."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from unicon_core.errors import WorkflowError
from unicon_core.located_yaml import parse_yaml
from unicon_core.robots import robot_files
from unicon_core.states.standard import HARDWARE_STATES
from unicon_core.workflow import Program, WorkflowDocument, load_document
from unicon_core.workflow.document import document_at
from unicon_ros.recording import Record
from unicon_ros.recording.facts import network_hash, robot_text

__all__ = ["others", "workflow_of"]


def workflow_of(
    record: Record,
    workflow: str | Path | None = None,
    overrides: Iterable[str] | Mapping[str, Any] = (),
) -> WorkflowDocument:
    """Return the workflow to replay a record with.

    Args:
        record: what was recorded.
        workflow: name or path; None for the recorded one with all its overrides. What it names,
            such as policies, is taken from where it was.
        overrides: as of `load_document`.

    Raises:
        WorkflowError: it cannot be read, or the record has none.
    """
    if workflow is not None:
        document = load_document(workflow, overrides)
    else:
        text = record.facts.get("workflow_effective", "")
        if not text:
            raise WorkflowError(
                "the record holds no workflow, since it was written in Python or imported; give "
                "one: unicon replay BAG WORKFLOW"
            )
        path = record.facts.get("workflow_path") or "the record's workflow"
        document = document_at(parse_yaml(text, path, WorkflowError), overrides)
    # A platform that cannot be asked here may have declared them.
    lacking = [name for name in HARDWARE_STATES if name in record.layout.slots]
    declared = document.get("states", dict, {})
    if lacking:
        document.values["states"] = dict.fromkeys(lacking) | declared
    return document


def others(record: Record, program: Program) -> list[str]:
    """Return what a program was not built of as the recorded one was, one line each."""
    found = []
    facts = record.facts
    if facts.get("robot_file") and facts["robot_file"] != robot_text(program.robot):
        where = " and ".join(map(str, robot_files(program.robot).values()))
        found.append(f"robot {program.robot.name}: {where} is not the recorded file")
    for name, was in _policies(record).items():
        contract = program.policies.get(name)
        if contract is None:
            found.append(f"policy {name!r} of the record is not in workflow {program.name}")
            continue
        now = network_hash(contract.model)
        if now != was:
            found.append(
                f"policy {name!r}: {contract.model} is not the recorded file: its sha256 is "
                f"{now[:12]}…, recorded is {was[:12]}…"
            )
    return found


def versions(record: Record) -> list[str]:
    """Return packages of other versions than the recorded ones, one line each."""
    from unicon_ros.recording.facts import versions_here

    try:
        recorded = json.loads(record.facts["versions"])
        here = versions_here()
        return [
            f"{name} {here[name]} here, {was} in the record"
            for name, was in recorded.items()
            if name in here and here[name] != was
        ]
    except (AttributeError, KeyError, TypeError, ValueError):
        return []


def _policies(record: Record) -> dict[str, str]:
    try:
        said = json.loads(record.facts["policies"])
        return {str(name): str(each["sha256"]) for name, each in said.items()}
    except (AttributeError, KeyError, TypeError, ValueError):
        return {}
