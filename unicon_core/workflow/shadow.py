"""The `shadow:` of a workflow: a policy that ticks beside one of its policies, and may replace it.

    policies: {walk: go2_velocity}
    shadow: {walk: ./newer}            # or {walk: {path: ./newer, blend: 0.3, bound: 0.4}}

Its states begin with `shadow_walk_`. See `unicon_core/policies/shadow.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial

from unicon_base import WorkflowError, alternatives
from unicon_core.flow import Block, Stage
from unicon_core.policies import Policy, PolicyContract, policy_states
from unicon_core.policies.controller import PrefixedStates
from unicon_core.policies.shadow import PAIRED, ShadowedPolicy, disagreement
from unicon_core.robots import Robot
from unicon_core.states import StateSpec, standard_states
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.file import ShadowEntry
from unicon_core.workflow.policies import ground_under, load_entry, used_policy
from unicon_core.workflow.uses import Use


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
