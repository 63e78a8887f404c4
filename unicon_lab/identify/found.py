"""Fit: what was found of joints, how well it holds, and the robot overlay that says it."""

from __future__ import annotations

from dataclasses import dataclass

from unicon_core.robots import Robot


@dataclass(frozen=True)
class Parameter:
    """One figure of one joint.

    Attributes:
        joint: its name.
        word: `strength`, `friction`, `armature` or `delay`.
        before: as the robot's simulator has it.
        after: as it was estimated.
        deviation: half of the 95 % interval.
    """

    joint: str
    word: str
    before: float
    after: float
    deviation: float

    @property
    def differs(self) -> bool:
        """Whether the interval leaves out what the simulator had."""
        return abs(self.after - self.before) > self.deviation


@dataclass(frozen=True)
class Fit:
    """What was found.

    Attributes:
        parameters: the figures that the motion tells of; all others stay as they are.
        before, after: mean of the joints' aligned MSE in [rad²] over the windows of the fit.
        held_before, held_after: the same over windows that the fit has not seen.
        by_joint: joint to its aligned MSE before and after, over all windows.
        windows: of the fit, and held out.
        rounds: that were made.
        noise: standard deviation in [rad] of what is left.
    """

    parameters: tuple[Parameter, ...]
    before: float
    after: float
    held_before: float
    held_after: float
    by_joint: dict[str, tuple[float, float]]
    windows: tuple[int, int]
    rounds: int
    noise: float

    @property
    def better(self) -> bool:
        """Whether it holds for what the fit has not seen."""
        return self.held_after < self.held_before

    def joints(self) -> dict[str, dict[str, float]]:
        """Return the figures that differ from the simulator's, as of `scene.joints`."""
        found: dict[str, dict[str, float]] = {}
        for each in self.parameters:
            if each.differs:
                found.setdefault(each.joint, {})[each.word] = each.after
        return found


def overlay_text(robot: Robot, extends: str, found: Fit, where: str) -> str:
    """Return the text of an overlay.

    Args:
        robot: that was fitted; what it says under `simulated` stays.
        extends: name or path of the robot file that is extended.
        found: the fit.
        where: from which it was made, for a comment.
    """
    joints = {name: dict(figures) for name, figures in robot.simulated.items()}
    intervals: dict[str, list[str]] = {}
    for name, figures in found.joints().items():
        joints.setdefault(name, {}).update(figures)
    for each in found.parameters:
        if each.differs:
            text = f"{each.word} ±{each.deviation:.2g}"
            intervals.setdefault(each.joint, []).append(text)
    lines = [
        f"# Written by unicon analyze --fit {where}",
        "# aligned MSE of windows that the fit has not seen: "
        f"{found.held_before:.4g} before, {found.held_after:.4g} rad² after",
        "schema: unicon.robot/1",
        f"extends: {extends}",
        "simulated:" if joints else "simulated: {}",
    ]
    for name, figures in joints.items():
        said = ", ".join(f"{word}: {figure:.4g}" for word, figure in figures.items())
        comment = f"   # 95 %: {', '.join(intervals[name])}" if name in intervals else ""
        lines.append(f'  "{name}": {{{said}}}{comment}')
    return "\n".join(lines) + "\n"
