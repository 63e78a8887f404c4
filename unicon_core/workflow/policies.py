"""Policies of a workflow: their contracts, their blocks, and shadows that tick beside them.

    policies: {walk: go2_velocity}
    shadow: {walk: ./newer}            # or {walk: {path: ./newer, blend: 0.3, bound: 0.4}}

A shadow may replace its policy; its states begin with `shadow_walk_`. See
`unicon_core/policies/shadow.py`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_base import AnyDict, AnyMapping, ModelError, PolicyError, WorkflowError, alternatives
from unicon_core.flow import Block, Stage
from unicon_core.models.find import model_of, pick_model
from unicon_core.policies import Policy, PolicyContract, load_policy, policy_states
from unicon_core.policies.action_map import lacking_joints
from unicon_core.policies.chunks import ChildSpec, RemoteSpec
from unicon_core.policies.controller import (
    ControllerContract,
    PrefixedStates,
    controller_contract,
    prefix_of,
)
from unicon_core.policies.perception import ImageTerm
from unicon_core.policies.policy import DrivenPolicy
from unicon_core.policies.policy_states import states_of
from unicon_core.policies.shadow import PAIRED, ShadowedPolicy, disagreement
from unicon_core.robots import Robot
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.terrain.height_map import HEIGHT_MAP, Heights, MapHeights
from unicon_core.terrain.words import FLAT, read_terrain
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument, read_part
from unicon_core.workflow.file import PolicyEntry, ShadowEntry
from unicon_core.workflow.platforms import facts_of_all, find_platforms
from unicon_core.workflow.uses import Use

if TYPE_CHECKING:
    from unicon_core.models.terrain import SceneGround


def load_policies(document: WorkflowDocument, robot: Robot) -> dict[str, PolicyContract]:
    """Load the contracts under `policies:`.

    Raises:
        PolicyError: a policy is missing, incomplete or contradictory.
        WorkflowError: an entry is of no known form.
    """
    names = document.get("policies", {})
    return {str(n): load_entry(document, robot, PolicyEntry, "policies", n)[0] for n in names}


def load_entry(
    document: WorkflowDocument, robot: Robot, kind: type[PolicyEntry], section: str, name: str
) -> tuple[PolicyContract, Any]:
    """Load the contract that an entry of a workflow names; return it and the entry.

    Args:
        document: the workflow.
        robot: that is to move.
        kind: of the entry.
        section: of the workflow, `policies` or `shadow`.
        name: of the entry there.

    Raises:
        PolicyError: the policy is missing, incomplete or contradictory.
        WorkflowError: the entry is of no known form.
    """

    def model() -> Path:
        """The model of the scene, else the robot's own; what is wrong with it is told later."""
        named = document.get("scene", {}).get("model")
        return pick_model(robot, named, document.path.parent)

    entry = document.values[section][name]
    said = {"path": entry} if isinstance(entry, str) else entry
    values: PolicyEntry = read_part(document, kind, said, section, name)
    what = f"{section.replace('policies', 'policy')} {name!r}"
    beside = document.path.parent / values.path
    path: str | Path = values.path
    if "/" in values.path and os.path.exists(beside):
        path = beside
    try:
        contract = load_policy(path, robot=robot, given=values.given or {}, model=model)
    except PolicyError as error:
        raise PolicyError(f"{what}: {error}") from error
    # Before a platform is built: a model of another robot would hide this behind its own error.
    lacking = lacking_joints(contract, robot)
    if lacking and all(lacking_joints(contract, each) for each in robot.members.values()):
        raise PolicyError(f"{what}: {lacking}")
    child = ChildSpec() if values.child is True else values.child or values.remote
    if isinstance(child, RemoteSpec) and child.keys is not None:
        child = replace(child, keys=(document.path.parent / child.keys).expanduser().resolve())
    return (contract if child is None else replace(contract, child=child)), values


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


def used_policy(use: Use, policies: AnyMapping) -> str:
    """Return the name of the policy that a `policy` block mentions.

    Raises:
        WorkflowError: none is named, or it is not under `policies:`.
    """
    name = use.options.get("policy", use.options.get("use", use.first))
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
    use: Use, policies: AnyMapping, robot: Robot, extra: Mapping[str, StateSpec]
) -> dict[str, StateSpec]:
    """Return the states that a policy block needs beyond the standard ones.

    Args:
        use: the mention of the policy.
        policies: all policies of the workflow.
        robot: the robot.
        extra: the workflow's own states, which terms may read.
    """
    name = used_policy(use, policies)
    for other, contract in policies.items():  # such as its last action, which terms may read
        prefix = prefix_of(other, policies)
        extra = {**extra, **{f"{prefix}{key}": s for key, s in states_of(contract).items()}}
    return policy_states(policies[name], robot.joint_names, extra, prefix=prefix_of(name, policies))


GROUND = ("ground",)
"""Where `BuildContext.models` holds the ground of the scene."""


def ground_under(context: BuildContext, contract: PolicyContract, states: States) -> Heights | None:
    """Return the height map, or the ground that a simulator lays, one for all policies.

    Args:
        context: of the workflow.
        contract: of the policy; None is returned where it has no height scan.
        states: that the policy reads.

    Raises:
        PolicyError: the platform is a robot, and there is no height map.
        ModelError: there is no model of the simulated robot.
    """
    if contract.height_scan is None:
        return None
    if HEIGHT_MAP in states:
        return MapHeights(states)
    platform = context.platform
    if platform is None or not platform.facts.simulated:
        where = "this part" if platform is None else f"platform {platform.facts.name!r}"
        raise PolicyError(
            f"policy {contract.name}: nothing fills its height_scan: {where} knows no ground, and "
            "there is no height_map; add the block elevation_map or grid_map, or simulate "
            "(platform: mujoco)"
        )
    if GROUND not in context.models:
        from unicon_core.models.load import load_model
        from unicon_core.models.terrain import SceneGround  # of such policies alone

        scene, robot = context.scene, context.robot
        path = pick_model(robot, scene.get("model"), context.relative_to)
        terrain = read_terrain(scene.get("terrain") or FLAT, scene.get("seed") or 0)
        context.models[GROUND] = SceneGround(load_model(path, robot, quiet=True), terrain)
    ground: SceneGround = context.models[GROUND]
    return ground


def image_terms(context: BuildContext) -> list[ImageTerm]:
    """Return what fills the pictures that the policies of these blocks see.

    Raises:
        UniconError: a camera is missing, or has other frames.
    """
    policies, shadow = context.policies, context.shadow
    contracts = {prefix_of(name, policies): policies[name] for name in policies}
    if shadow is not None:
        contracts[shadow.prefix] = shadow.contract
    read = {name for block in context.blocks for name in block.reads}
    return [
        ImageTerm(context, f"{prefix}{name}", spec)
        for prefix, contract in contracts.items()
        for name, spec in contract.images.items()
        if f"{prefix}{name}" in read
    ]


def policy_factory(use: Use, policies: AnyMapping) -> Callable[..., Any]:
    """Return the factory of the block that runs the mentioned policy."""
    name = used_policy(use, policies)
    contract, prefix, key = policies[name], prefix_of(name, policies), (name, use.of)

    def policy(
        context: BuildContext,
        use: str = "",
        policy: str = "",
        drives: Sequence[str] = (),
        sees_default_for: Sequence[str] = (),
    ) -> Any:
        if context.shadow is not None and context.shadow.of == name:
            return context.shadow.beside(made_with(context, context.states), context)
        if drives or sees_default_for:
            return DrivenPolicy(
                lambda states: made_with(context, states),
                context.states,
                context.robot,
                drives,
                sees_default_for,
            )
        return made_with(context, context.states)

    def made_with(context: BuildContext, states: States) -> Any:
        model = None
        if contract.motion is not None and not contract.motion.chain:
            with suppress(ModelError):  # told where it is needed
                model = model_of(context.platform, context.robot)
        others = [each for each in policies.values() if each.action.kinds]
        options: AnyDict = {"prefix": prefix, "model": model, "every_target": bool(others)}
        options["ground"] = ground_under(context, contract, states)
        if contract.child is None:
            return Policy(contract, states, context.robot, **options)
        from unicon_core.policies.child_policy import ChildPolicy  # of Linux alone

        made = ChildPolicy(
            contract,
            states,
            context.robot,
            period=context.period,
            paced=context.paced,
            tell=context.tell,
            network=context.networks.get(key),
            **options,
        )
        if key not in context.networks:
            context.networks[key] = made.network
            for warning in made.network.warnings:
                context.tell(warning)
        return made

    # Annotations are text here; the autowiring evaluates them in this module.
    return policy


@dataclass(frozen=True)
class Shadow:
    """What stands beside a policy of a workflow.

    Attributes:
        of: name of that policy.
        contract: of what stands beside it.
        entry: what the workflow says.
    """

    of: str
    contract: PolicyContract
    entry: ShadowEntry

    @property
    def prefix(self) -> str:
        """What the names of its states begin with."""
        return f"shadow_{self.of}_"

    def states(self, robot: Robot, extra: Mapping[str, StateSpec]) -> dict[str, StateSpec]:
        """Return the states to declare.

        Args:
            robot: that moves.
            extra: all other states of the workflow, which terms may name.
        """
        joints, prefix = robot.joint_names, self.prefix
        standard = standard_states(joints)
        number = partial(StateSpec, ())
        said = "target minus the other policy's"
        own = {
            **{name: standard[name] for name in PAIRED},
            "target_difference": StateSpec((len(joints),), "float32", "rad", "", joints, said),
            "share": number(description="of its targets in the command"),
            "time": number("float32", "s", description="of its last tick"),
            "request": number("int32", description="1: swap"),
        }
        states = policy_states(self.contract, joints, extra, prefix=prefix)
        return states | {prefix + name: spec for name, spec in own.items()}

    def beside(self, policy: Policy, context: BuildContext) -> ShadowedPolicy:
        """Return a policy with the one beside it, as one block."""
        states, contract = context.states, self.contract
        redirected = PrefixedStates(states, "", {name: self.prefix + name for name in PAIRED})
        ground = ground_under(context, contract, states)
        other = Policy(contract, redirected, context.robot, prefix=self.prefix, ground=ground)
        names, every = (self.of, f"shadow_{self.of}"), round(contract.period / context.period)
        return ShadowedPolicy(policy, other, states, names, self.entry, every, context.tell)


def shadow_of(
    document: WorkflowDocument,
    robot: Robot,
    policies: Mapping[str, PolicyContract],
    uses: Iterable[Use],
) -> Shadow | None:
    """Return what a workflow says under `shadow:`, None where it says nothing.

    Raises:
        WorkflowError: more than one, no such policy, or one that cannot have a shadow.
        PolicyError: its policy is missing, incomplete or contradictory.
    """
    listed = document.get("shadow", {})
    if not listed:
        return None

    def wrong(text: str) -> WorkflowError:
        return document.error(f"shadow: {text}", "shadow")

    name = next(iter(listed))
    if len(listed) > 1:
        raise wrong(f"names {', '.join(listed)}; leave all but one out")
    if name not in policies:
        raise wrong(f"no policy {name!r} under 'policies:'; {alternatives(name, policies)}")
    for key in ("num_robots", "parts"):
        if document.values.get(key) is not None:
            raise wrong(f"it is of one robot in one process; leave out {key}")
    mentions = [u for u in uses if u.word == "policy" and used_policy(u, policies) == name]
    if len(mentions) != 1 or mentions[0].of or mentions[0].options.keys() - {"policy", "use"}:
        raise wrong(
            f"policy {name!r} stands {len(mentions)} times in the flow; write it once, without "
            "of, drives and sees_default_for"
        )
    contract, entry = load_entry(document, robot, ShadowEntry, "shadow", name)
    if why := disagreement(policies[name], contract):
        raise wrong(f"{why}; name another policy, or leave it out")
    return Shadow(name, contract, entry)


def shadowed_in(blocks: Iterable[Block]) -> ShadowedPolicy | None:
    """Return the policy that has one beside it, None where there is none."""
    return next((b.tick for b in blocks if isinstance(b.tick, ShadowedPolicy)), None)


def shadow_blocks(blocks: Iterable[Block]) -> list[tuple[Stage, Block]]:
    """Return what a shadow needs before and behind the flow, each with its stage."""
    tick = shadowed_in(blocks)
    if tick is None:
        return []
    heard = Block("swap request", tick.hear, writes=tick.heard, endless=True)
    own = tuple(name for name in tick.writes if name not in PAIRED)
    observed = Block("shadow", tick.observe, reads=PAIRED, amends=own, endless=True)
    return [(Stage.RECV, heard), (Stage.OBSERVE, observed)]
