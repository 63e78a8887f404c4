"""`check_workflow`: all checks of a workflow before a motor moves, for `unicon check` and CI."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from unicon_core.check.action import check_action, check_commands, check_timing
from unicon_core.check.action_rates import check_fed
from unicon_core.check.files import check_files, check_robot
from unicon_core.check.gains import check_gains, check_held, check_limits
from unicon_core.check.graph import check_blocks, check_memory, prove_memory
from unicon_core.check.joints import check_joints
from unicon_core.check.observation import check_frames, check_observation
from unicon_core.check.order import check_order
from unicon_core.check.parts import check_keys, check_parts
from unicon_core.check.pose import check_pose
from unicon_core.check.reach import check_bodies, check_reach
from unicon_core.check.result import CheckResult
from unicon_core.check.safety import check_safety
from unicon_core.check.seen import check_seen
from unicon_core.check.start import check_gates, check_start
from unicon_core.check.subject import Subject, build_subject
from unicon_core.errors import (
    MissingDependencyError,
    ModelError,
    PlatformError,
    PolicyError,
    RobotError,
    UniconError,
)
from unicon_core.workflow import Hook
from unicon_core.workflow.document import WorkflowDocument, load_document

Check = Callable[[Subject, CheckResult], None]

CHECKS: tuple[Check, ...] = (
    check_joints, check_order, check_gains, check_held, check_limits, check_observation,
    check_action, check_fed, check_timing, check_commands, check_pose, check_start, check_gates,
    check_safety, check_parts, check_keys, check_reach, check_robot,
)  # fmt: skip
"""Those that `unicon run` asks, too."""

SLOWER: tuple[Check, ...] = (
    check_frames, check_files, check_bodies, check_blocks, check_memory, check_seen,
)  # fmt: skip
"""They read the platform, hash files, or repeat what the build has done."""

_CULPRITS: tuple[tuple[type[UniconError], str], ...] = (
    (RobotError, "robot"),
    (ModelError, "model"),
    (PolicyError, "policy"),
    (PlatformError, "platform"),
    (MissingDependencyError, "installation"),
    (UniconError, "workflow"),
)


def check_workflow(
    name_or_path: str | Path,
    overrides: Iterable[str] = (),
    *,
    twin: bool = False,
    more: Iterable[Check] = (),
    hooks: Sequence[Hook] = (),
) -> CheckResult:
    """Check a workflow without moving anything.

    Hardware is never opened: its platform is exchanged for `fake`. A workflow that cannot be built
    gives its error as a finding.

    Args:
        name_or_path: a name in `config/workflows/`, or a path.
        overrides: `path=value` texts as of `--set`.
        twin: also simulate it, and broken contracts beside it.
        more: further checks of the built workflow, such as that of its message map.
        hooks: hooks that stand for what a run would add to the graph, such as topics.

    Returns:
        Tables, findings and notes; `findings` is empty where all is well.
    """
    result = CheckResult(Path(str(name_or_path)).stem)
    try:
        document = load_document(name_or_path, overrides)
        result.workflow = document.name
        settings = check_section(document, result)
        subject = build_subject(document, hooks)
    except UniconError as error:
        culprit = next(name for kind, name in _CULPRITS if isinstance(error, kind))
        for each in error.problems or (error,):
            result.find_error("build", culprit, each)
        return result
    try:
        platform = subject.platform
        kind = "simulated" if platform.simulated else "hardware, not opened"
        result.subject = (
            f"robot {subject.robot.name}, platform {platform.name} ({kind}), {document.path}"
        )
        for note in subject.program.platform.facts.notes:
            result.note("platform.open", f"platform {platform.name!r}", note)
        static_checks(subject, result)
        for check in more:
            check(subject, result)
        if twin:
            prove_memory(subject, result)
    finally:
        subject.program.close()
    if twin:
        from unicon_core.check.twin import check_twin

        check_twin(document, subject.program.platform, settings, result)
    return result


def static_checks(subject: Subject, result: CheckResult) -> None:
    """Do all checks that take no run; of a live subject those that a run has not done itself.

    Args:
        subject: what is checked.
        result: is added to.
    """
    checks = CHECKS if subject.live else (*CHECKS, *SLOWER)
    for check in checks:
        check(subject, result)
    result.sort()


def check_section(document: WorkflowDocument, result: CheckResult) -> dict[str, Any]:
    """Return the workflow's `check:` section, its codes accepted by the result."""
    settings: dict[str, Any] = document.get("check", {})
    if settings.get("accept") is not None:
        result.accept(settings["accept"], document.where("check", "accept"))
    return settings
