"""What is checked: a workflow built without touching a motor, and what its platform can do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property

from unicon_base import AnyMapping
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.flow import Block, Stage, blocks_of
from unicon_core.models.find import Modelled
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel
from unicon_core.platforms.platform import Facts
from unicon_core.policies import PolicyContract
from unicon_core.policies.controller import (
    PackedStates,
    PrefixedStates,
    controller_contract,
    prefix_of,
)
from unicon_core.robots import Robot
from unicon_core.workflow import Hook, Program, WorkflowDocument
from unicon_core.workflow.hardware import can_wait
from unicon_core.workflow.platforms import facts_of_all, find_platforms, platform_options
from unicon_core.workflow.policies import shadowed_in
from unicon_core.workflow.program_data import ProgramData


@dataclass
class Subject:
    """A built workflow and its parts, as the checks see them.

    Attributes:
        document: the workflow file.
        program: what was built; by `build_subject` with `fake` in place of hardware, so nothing
            moves.
        platform: facts that the document's platform declares, not the exchanged one.
        waits: whether ticks may come with that platform's data.
        live: it is about to run: the platform is left as it was, and what only tables show is not
            computed.
    """

    document: WorkflowDocument
    program: ProgramData
    platform: Facts
    waits: bool
    live: bool = False

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.program.robot

    @cached_property
    def policies(self) -> dict[str, PolicyContract]:
        """Key under `policies:` to contract, of those that the flow uses and of a shadow."""
        used = [controller_contract(block) for block in self.program.blocks]
        named = self.program.policies.items()
        beside = shadowed_in(self.program.blocks)
        others = {} if beside is None else {beside.names[1]: beside.b.contract}
        return {key: contract for key, contract in named if contract in used} | others

    def policy_results(self, result: CheckResult) -> list[PolicyResult]:
        """Return for each policy of the flow what adds to a result in its name."""
        return [PolicyResult(result, *policy) for policy in self.policies.items()]

    def states_of(self, key: str) -> PackedStates:
        """Return the states as one policy sees them: with several, each has its own `action`."""
        states = self.program.states
        named = self.program.policies
        prefix = prefix_of(key, named) if key in named else f"{key}_"
        return PrefixedStates(states, prefix) if prefix else states

    @cached_property
    def blocks(self) -> list[Block]:
        """All blocks of the flow, without recv and send."""
        return [b for b in blocks_of(self.program.root) if b.stage not in (Stage.RECV, Stage.SEND)]

    @cached_property
    def written(self) -> frozenset[str]:
        """States that some block of the workflow writes or estimates, or a device."""
        devices = [b for node in self.program.stages[Stage.RECV][1:] for b in blocks_of(node)]
        estimated = [block for block in self.blocks if block.stage is Stage.ESTIMATE]
        written = [name for block in (*devices, *self.blocks) for name in block.writes]
        return frozenset((*written, *(name for block in estimated for name in block.amends)))

    @cached_property
    def model(self) -> LoadedModel | None:
        """The model that the platform simulates as its file has it; None if it simulates none."""
        platform = self.program.platform
        if not isinstance(platform, Modelled):
            return None
        return load_model(platform.model_path, self.robot, quiet=True)


def declared_platform(document: WorkflowDocument) -> tuple[Facts, bool]:
    """Return what the workflow's platform declares and whether it waits, without building it.

    Raises:
        WorkflowError: no such platform, or it has no such option.
        MissingDependencyError: it needs a package that is not installed.
    """
    chosen = find_platforms(document)
    platform_options(document, chosen)
    base = next(iter(chosen.values()))
    return facts_of_all(chosen), can_wait(base.factory) and base.use.child is None


def build_subject(document: WorkflowDocument, hooks: Sequence[Hook] = ()) -> Subject:
    """Build what is to be checked as a run builds it, but for hardware, which is never opened.

    Args:
        document: the workflow.
        hooks: as of `Program`.

    Raises:
        UniconError: the workflow cannot be built.
    """
    facts, waits = declared_platform(document)
    return Subject(document, Program(document, dry=True, hooks=hooks), facts, waits)


def on_platform(
    document: WorkflowDocument, name: str, scene: AnyMapping | None = None
) -> WorkflowDocument:
    """Return the same workflow on another platform.

    Args:
        document: stays as it is.
        name: of the platform.
        scene: used where the document has none.
    """
    values = deepcopy(document.values)
    values["platform"] = name
    values.pop("num_robots", None)
    if isinstance(values.get("pacing"), dict):  # simulators have no data to wait for
        for key in ("trigger", "every"):
            values["pacing"].pop(key, None)
    if scene and not values.get("scene"):
        values["scene"] = dict(scene)
    return replace(document, values=values)


def listed(names: Iterable[str], limit: int = 4) -> str:
    """Return names for a message, cut off after a few."""
    names = list(names)
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more
