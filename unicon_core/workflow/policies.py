"""Policies of a workflow: loads the contracts and gives each mention of one its block."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from unicon_core.errors import ModelError, PolicyError, WorkflowError, alternatives
from unicon_core.flow import Block
from unicon_core.models.find import model_of, pick_model
from unicon_core.policies import Policy, PolicyContract, load_policy, policy_states
from unicon_core.policies.action_map import lacking_joints
from unicon_core.policies.controller import ControllerContract, controller_contract
from unicon_core.policies.prefixed import prefix_of
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.platforms import facts_of_all, find_platforms
from unicon_core.workflow.uses import Use

__all__ = [
    "controllers_reading",
    "declared_states",
    "load_policies",
    "policy_factory",
    "with_weldable",
]


def load_policies(document: WorkflowDocument, robot: Robot) -> dict[str, PolicyContract]:
    """Load the contracts under `policies:`.

    Raises:
        PolicyError: a policy is missing, incomplete or contradictory.
        WorkflowError: an entry is of no known form.
    """
    contracts = {}

    def model() -> Path:
        """The model of the scene, else the robot's own; what is wrong with it is told later."""
        named = document.get("scene", dict, {}).get("model")
        named = named if isinstance(named, (str, Path)) else None
        return pick_model(robot, named, document.path.parent)

    for name, entry in document.get("policies", dict, {}).items():
        values = _checked_entry(document, name, entry)
        beside = document.path.parent / values["path"]
        path: str | Path = values["path"]
        if "/" in values["path"] and os.path.exists(beside):
            path = beside
        try:
            given = values.get("given") or {}
            contract = load_policy(path, robot=robot, given=given, model=model)
        except PolicyError as error:
            raise PolicyError(f"policy {name!r}: {error}") from error
        # Before a platform is built: a model of another robot would hide this behind its own error.
        lacking = lacking_joints(contract, robot)
        if lacking and all(lacking_joints(contract, each) for each in robot.members.values()):
            raise PolicyError(f"policy {name!r}: {lacking}")
        contracts[str(name)] = contract
    return contracts


def _checked_entry(document: WorkflowDocument, name: str, entry: Any) -> dict[str, Any]:
    """Return path and given of a policy."""

    def wrong(what: str, *path: str) -> WorkflowError:
        return document.error(f"policy {name!r}: {what}", "policies", name, *path)

    values = {"path": entry} if isinstance(entry, str) else entry
    if not isinstance(values, dict) or not isinstance(values.get("path"), str):
        others = [str(other) for other in document.values["policies"] if other != name]
        hint = f"; {alternatives(name, others)}" if others else ""
        raise wrong(f"needs a path, or a mapping {{path: …, given: …}}{hint}")
    if not isinstance(values.get("given") or {}, dict):
        raise wrong(f"given is {values['given']!r}; write a mapping of facts", "given")
    for key in values:
        if key not in ("path", "given"):
            raise wrong(f"unknown key {key!r}; known: path, given", key)
    return values


def with_weldable(
    document: WorkflowDocument, robot: Robot, policies: Mapping[str, PolicyContract]
) -> Robot:
    """Return a robot that says which joints no policy moves: a simulated model may lack them."""
    moved = {name for contract in policies.values() for name in contract.action.joints}
    held = frozenset(robot.joint_names) - moved
    if not policies or not held or robot.members:
        return robot
    simulated = facts_of_all(find_platforms(document)).simulated
    return replace(robot, weldable=held) if simulated else robot


def used_policy(use: Use, policies: Mapping[str, Any]) -> str:
    """Return the name of the policy that a `policy` block mentions.

    Raises:
        WorkflowError: none is named, or it is not under `policies:`.
    """
    name = use.options.get("use", use.first)
    if name is None and len(policies) == 1:
        return next(iter(policies))
    if not isinstance(name, str) or name not in policies:
        declared = alternatives(str(name), policies)
        raise WorkflowError(
            f"no policy {name!r} under 'policies:'; {declared}; write policy: NAME", use.where
        )
    return name


def controllers_reading(
    state: str, blocks: Iterable[Block], policies: Mapping[str, PolicyContract]
) -> list[tuple[str, ControllerContract]]:
    """Return the controllers in these blocks that read a state, with what to call them.

    Args:
        state: its name.
        blocks: of the flow.
        policies: the workflow's name for each policy.
    """
    called = {id(contract): f"policy {name!r}" for name, contract in policies.items()}
    used = {id(c): c for b in blocks if state in b.reads and (c := controller_contract(b))}
    return [(called.get(i, f"controller {c.name!r}"), c) for i, c in used.items()]


def declared_states(
    use: Use,
    policies: Mapping[str, Any],
    robot: Robot,
    extra: Mapping[str, StateSpec],
) -> dict[str, StateSpec]:
    """Return the states that a policy block needs beyond the standard ones.

    Args:
        use: the mention of the policy.
        policies: all policies of the workflow.
        robot: the robot.
        extra: the workflow's own states, which terms may read.
    """
    name = used_policy(use, policies)
    return policy_states(policies[name], robot.joint_names, extra, prefix=prefix_of(name, policies))


def policy_factory(use: Use, policies: Mapping[str, Any]) -> Callable[..., Any]:
    """Return the factory of the block that runs the mentioned policy."""
    name = used_policy(use, policies)
    contract, prefix = policies[name], prefix_of(name, policies)

    def policy(context: BuildContext, use: str = "") -> Any:
        model = None
        if contract.motion is not None and not contract.motion.chain:
            with suppress(ModelError):  # told where it is needed
                model = model_of(context.platform, context.robot)
        others = [each for each in policies.values() if each.action.kinds]
        return Policy(
            contract,
            context.states,
            context.robot,
            prefix=prefix,
            model=model,
            every_target=bool(others),
        )

    # Annotations are text here; the autowiring evaluates them in this module.
    return policy
