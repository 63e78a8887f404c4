"""The workflow of a replay: one that is named, or the one in the record."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from unicon_base import AnyDict, AnyMapping, UniconError, WorkflowError
from unicon_base.located_yaml import Located, parse_yaml
from unicon_base.resources import find_config
from unicon_core.robots import Robot, robot_files
from unicon_core.states.standard import GAIN_SCALE, GAIN_SCALE_SPEC, HARDWARE_STATES
from unicon_core.workflow import Program, WorkflowDocument, load_document
from unicon_core.workflow.document import document_at
from unicon_lab.recording import Record
from unicon_lab.recording.run_recording import network_hash, robot_facts, versions_here


def workflow_of(
    record: Record,
    workflow: str | Path | None = None,
    overrides: Iterable[str] | AnyMapping = (),
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
        recorded = recorded_workflow(record)
        if recorded is None:
            raise WorkflowError(
                "the record holds no workflow, since it was written in Python or imported; give "
                "one: unicon replay BAG WORKFLOW"
            )
        document = document_at(recorded, overrides)
        _refuse_absent(document)
    # A platform that cannot be asked here may have declared them.
    there = record.layout.specs
    lacking: AnyDict = {name: None for name in HARDWARE_STATES if name in there}
    if there.get(GAIN_SCALE) == GAIN_SCALE_SPEC:
        lacking[GAIN_SCALE] = GAIN_SCALE_SPEC.to_dict()
    declared = document.get("states", {})
    if lacking:
        document.values["states"] = lacking | declared
    return document


def recorded_workflow(record: Record) -> Located | None:
    """Return the text of the workflow in a record, read as YAML; None where there is none.

    Raises:
        WorkflowError: it is not YAML, or more of it than is read.
    """
    text = record.facts.get("workflow_effective", "")
    path = record.facts.get("workflow_path") or "the record's workflow"
    return parse_yaml(text, path, WorkflowError) if text else None


def recorded_values(record: Record) -> AnyDict:
    """Return what the workflow in a record says; as `recorded_workflow`."""
    workflow = recorded_workflow(record)
    return workflow.value if workflow and isinstance(workflow.value, dict) else {}


def robot_of(record: Record) -> str:
    """Return the file of a record's robot, or the name of one that has members.

    As its workflow names it; where it has none, as it was recorded or imported, else by its name.

    Raises:
        UniconError: it is not there.
    """
    name, was = record.facts.get("robot", ""), record.facts.get("robot_path", "")
    workflow = None
    with suppress(WorkflowError):  # somebody's text, which says nothing
        workflow = recorded_workflow(record)
    values = None if workflow is None else workflow.value
    given = values.get("robot") if isinstance(values, dict) else None
    if isinstance(given, dict):
        return name
    if workflow is None or not isinstance(given, str):
        given, folder = (was if os.path.isfile(was) else name), None
    else:
        folder = workflow.path.parent
    try:
        return str(find_config("robots", given, relative_to=folder))
    except UniconError as error:
        where = f" ({was} is gone)" if given == name and was else ""
        if folder and "/" in given:
            where = f" ({given} was in {folder})"
        raise UniconError(
            f"{record.paths[0].name}: its robot {name!r} is not here{where}: {error}"
        ) from None


def _refuse_absent(document: WorkflowDocument) -> None:
    """Refuse a recorded workflow whose files stayed where it was recorded."""
    named = {"robot": document.values.get("robot")}
    policies = document.values.get("policies")
    for name, said in policies.items() if isinstance(policies, dict) else ():
        named[f"policies.{name}"] = said.get("path") if isinstance(said, dict) else said
    folder = document.path.parent
    for key, text in named.items():
        if not isinstance(text, str) or not text.startswith(("/", "./", "../")):
            continue
        if any(f"{key}.".startswith(f"{each}.") for each in document.overridden):
            continue  # the loader names the override
        if not os.path.exists(folder / text) and not os.path.exists(text):
            raise WorkflowError(
                f"the recorded workflow has {key}: {text}, which was in {folder} where it was "
                f"recorded and is not there now; give another: --set {key}=NAME, or a WORKFLOW"
            )


def others(record: Record, program: Program) -> list[str]:
    """Return what a program was not built of as the recorded one was, one line each."""
    found = _other_robot(record.facts, program.robot)
    for name, said in record.policies.items():
        contract = program.policies.get(name)
        if contract is None:
            found.append(f"policy {name!r} of the record is not in workflow {program.name}")
            continue
        parts = said.get("networks")
        recorded = {"": said["sha256"], **(parts if isinstance(parts, dict) else {})}
        here = {"": contract.model}
        if isinstance(parts, dict):  # versions that knew one alone do not tell
            here |= {part.name: part.model for part in contract.networks}
        for part in {**recorded, **here}:
            what = f"policy {name!r}{part and f', network {part!r}'}"
            if part not in recorded or part not in here:
                where = "here" if part not in recorded else "in the record"
                found.append(f"{what} is only {where}")
            elif (now := network_hash(here[part])) != recorded[part]:
                found.append(
                    f"{what}: {here[part]} is not the recorded file: its sha256 is "
                    f"{now[:12]}…, recorded is {str(recorded[part])[:12]}…"
                )
    return found


def _other_robot(facts: Mapping[str, str], robot: Robot) -> list[str]:
    found, here = [], robot_facts(robot)
    if facts.get("robot_file") and facts["robot_file"] != here["robot_file"]:
        where = " and ".join(map(str, robot_files(robot).values()))
        found.append(f"robot {robot.name}: {where} is not the recorded file")
    was = facts.get("robot_overlay")
    if was is None:  # of a version that did not write it
        return found
    now = here["robot_overlay"]
    if now != was:
        if not now:
            told = "the recorded one was extended by an overlay, and this one is not"
        elif not was:
            told = f"{robot.overlay} extends it, and the recorded one was not extended"
        else:
            told = f"{robot.overlay} is not the recorded overlay"
        found.append(f"robot {robot.name}: {told}")
    return found


def versions(record: Record) -> list[str]:
    """Return packages of other versions than the recorded ones, one line each."""
    recorded = record.told("versions", dict)
    here = versions_here()
    return [
        f"{name} {here[name]} here, {was} in the record"
        for name, was in recorded.items()
        if name in here and here[name] != was
    ]
