"""What is checked: a workflow built without touching a motor, and what its platform can do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from unicon_core.flow import Block, Stage, blocks_of
from unicon_core.models.find import Modelled
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel
from unicon_core.policies import PolicyContract
from unicon_core.policies.controller import controller_contract
from unicon_core.policies.prefixed import PrefixedStates
from unicon_core.policies.terms import PackedStates
from unicon_core.robots import Robot
from unicon_core.workflow import Hook, Program
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.hardware import is_simulator
from unicon_core.workflow.platforms import find_platform, platform_options

__all__ = ["NOT_ON_HARDWARE", "PlatformFacts", "Subject", "build_subject", "platform_facts"]

NOT_ON_HARDWARE = ("base_lin_vel", "base_pos_w")
"""What no sensor of a legged robot measures: it takes an estimator or a tracking system."""


@dataclass(frozen=True)
class PlatformFacts:
    """What is known of a platform before it is built.

    Attributes:
        name: word that the workflow uses.
        simulated: whether it is a simulator. A factory says so by an attribute `simulated`.
        unmeasured: states that it does not write; a factory may say what it does write by an
            attribute `writes`.
        waits: of hardware, whether ticks may come with its data; a factory may say no by an
            attribute `waits`.
    """

    name: str
    simulated: bool
    unmeasured: tuple[str, ...]
    waits: bool = False


@dataclass
class Subject:
    """A built workflow and its parts, as the checks see them.

    Attributes:
        document: the workflow file.
        workflow: built; by `build_subject` with `fake` in place of hardware, so nothing moves.
        platform: of the document, not the exchanged one.
        live: it is about to run: the platform is left as it was, and what only tables show is not
            computed.
    """

    document: WorkflowDocument
    program: Program
    platform: PlatformFacts
    live: bool = False

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.program.robot

    @cached_property
    def policies(self) -> dict[str, PolicyContract]:
        """Key under `policies:` to contract, those that the flow uses."""
        used = [controller_contract(block) for block in self.program.blocks]
        named = self.program.policies.items()
        return {key: contract for key, contract in named if contract in used}

    def states_of(self, key: str) -> PackedStates:
        """Return the states as one policy sees them: with several, each has its own `action`."""
        states = self.program.states
        return states if len(self.program.policies) < 2 else PrefixedStates(states, f"{key}_")

    @cached_property
    def blocks(self) -> list[Block]:
        """All blocks of the flow, without recv and send."""
        return [b for b in blocks_of(self.program.root) if b.stage not in (Stage.RECV, Stage.SEND)]

    @cached_property
    def written(self) -> frozenset[str]:
        """States that some block of the workflow writes."""
        return frozenset(name for block in self.blocks for name in block.writes)

    @cached_property
    def model(self) -> LoadedModel | None:
        """The model that the platform simulates as its file has it; None if it simulates none."""
        platform = self.program.platform
        if not isinstance(platform, Modelled):
            return None
        return load_model(platform.model_path, self.robot, quiet=True)


def platform_facts(document: WorkflowDocument) -> PlatformFacts:
    """Return what is known of the workflow's platform, and check its options without building it.

    Raises:
        WorkflowError: no such platform, or it has no such option.
        MissingDependencyError: it needs a package that is not installed.
    """
    name, factory = find_platform(document)
    if is_simulator(name, factory):
        return PlatformFacts(name, True, ())
    platform_options(document, name, factory)
    writes = getattr(factory, "writes", None)
    unmeasured: tuple[str, ...] = NOT_ON_HARDWARE
    if writes is not None:
        unmeasured = tuple(state for state in NOT_ON_HARDWARE if state not in writes)
    return PlatformFacts(name, False, unmeasured, bool(getattr(factory, "waits", True)))


def build_subject(document: WorkflowDocument, hooks: Sequence[Hook] = ()) -> Subject:
    """Build what is to be checked as a run builds it, but for hardware, which is never opened.

    Args:
        document: the workflow.
        hooks: as of `Program`.

    Raises:
        UniconError: the workflow cannot be built.
    """
    facts = platform_facts(document)
    return Subject(document, Program(document, dry=True, hooks=hooks), facts)


def on_platform(
    document: WorkflowDocument, name: str, options: Mapping[str, Any] | None = None
) -> WorkflowDocument:
    """Return the same workflow on another platform.

    Args:
        document: stays as it is.
        name: of the platform.
        options: used where the document has none for that platform.
    """
    values = deepcopy(document.values)
    values["platform"] = name
    values.pop("num_robots", None)
    if isinstance(values.get("pacing"), dict):  # simulators have no data to wait for
        values["pacing"].pop("trigger", None)
    if options is not None:
        platforms = values.setdefault("platforms", {})
        given = dict(platforms.get(name) or {})
        platforms[name] = given or dict(options)
    return replace(document, values=values)


def listed(names: Iterable[str], limit: int = 4) -> str:
    """Return names for a message, cut off after a few."""
    names = list(names)
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more
