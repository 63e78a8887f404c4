"""What a robot reaches with: bodies that its file names, and what arms do not keep away from."""

from __future__ import annotations

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject
from unicon_core.errors import alternatives


def check_reach(subject: Subject, result: CheckResult) -> None:
    """Note the pairs of capsules that a block `reach` leaves out."""
    for block in subject.blocks:
        for note in getattr(block.tick, "notes", ()):
            result.note("reach.apart", f"block {block.name!r}", note, where=block.where)


def check_bodies(subject: Subject, result: CheckResult) -> None:
    """Note end effectors and capsules of the robot file on bodies that the model lacks.

    No block of this workflow uses one: a block that does is not built without the body.
    """
    robot = subject.robot
    named = {f"end effector {name!r}": place.body for name, place in robot.end_effectors.items()}
    named |= {f"capsule {name!r}": capsule.body for name, capsule in robot.capsules.items()}
    if not named or subject.model is None:
        return
    model = subject.model.model
    known = [model.body(i).name for i in range(1, model.nbody)]
    for what, body in named.items():
        if body not in known:
            evidence = f"{what} is on body {body!r}, which model {subject.model.path} lacks"
            remedy = f"no block uses it; {alternatives(body, known)}"
            result.note("model.bodies", f"robot {robot.name}", evidence, remedy, robot.path)
