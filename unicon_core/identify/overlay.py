"""The overlay of a fit: a robot file that extends another one by what was estimated."""

from __future__ import annotations

from unicon_core.identify.found import Fit
from unicon_core.robots import Robot


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
