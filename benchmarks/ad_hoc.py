"""Ad hoc: what the same moves took in public code that was written for one robot, in lines.

The counterpart of the row "Ad-hoc" in the UniCon paper's table of transfer effort, whose own code
is not public: 852 lines for an H1, and 507, 627 and 770 changed ones for simulation, G1 and Adam.
The files were counted by `code_of`, as ours are; a test counts them again where they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class AdHoc:
    """Code for one move.

    Attributes:
        repository: on GitHub, with the commit's first digits.
        files: paths in it, and of each the file of `unitree_rl_gym` that it is laid out like, or
            "".
        lines: with code or content, of all files.
        new: of these, the ones that are not in the file that theirs is laid out like.
        note: what else there is to say.
    """

    repository: str
    files: Mapping[str, str] = field(repr=False)
    lines: int
    new: int
    note: str = ""

    def __str__(self) -> str:
        note = f"; {self.note}" if self.note else ""
        return f"{self.new} new of {self.lines} lines in {self.repository}{note}"


PAPER = {"H1": 852, "Sim": 507, "G1": 627, "Adam": 770}
"""The paper's row "Ad-hoc": its code base for H1, and lines changed for the others."""

_GYM = "unitreerobotics/unitree_rl_gym@276801e"
_REAL = "deploy/deploy_real"
_PROGRAM = (
    *("deploy_real.py", "config.py", "common/command_helper.py"),
    *("common/remote_controller.py", "common/rotation_helper.py"),
)
_H1 = f"{_REAL}/configs/h1.yaml"

AD_HOC = {
    "H1 → H1": AdHoc(
        _GYM, {f"{_REAL}/{name}": f"{_REAL}/{name}" for name in _PROGRAM} | {_H1: _H1}, 360, 0
    ),
    "H1 → H1 in MuJoCo": AdHoc(
        _GYM,
        {"deploy/deploy_mujoco/deploy_mujoco.py": "", "deploy/deploy_mujoco/configs/h1.yaml": ""},
        104,
        104,
        "a program of its own",
    ),
    "H1 → G1": AdHoc(
        _GYM, {f"{_REAL}/configs/g1.yaml": _H1}, 31, 22, "the program knows the messages of both"
    ),
    "G1 → Adam": AdHoc(
        "pndbotics/pnd_rl_mjlab@6c724bf",
        {f"{_REAL}/{name}": f"{_REAL}/{name}" for name in _PROGRAM}
        | {f"{_REAL}/configs/adam_sp_velocity_flat.yaml": _H1},
        640,
        541,
        "laid out as unitree_rl_gym; tracks motions as well",
    ),
    "G1 in MuJoCo → T1 in MuJoCo": AdHoc(
        "BoosterRobotics/booster_gym@da396a0",
        {"play_mujoco.py": ""},
        121,
        121,
        "a program of its own",
    ),
}
"""Move of `bench sloc` to public code that does the same."""
