"""Old import paths: they lead to where a module is now, with a warning, for one release.

`import unicon_core` and `import unicon_ros` put the finder in place.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_NAMES = {
    (
        "unicon_core",
        "unicon_base",
    ): "arrays bounded_yaml errors generated located_yaml packages resources schema",
    ("unicon_core", "unicon_manipulation"): "ik retarget",
    ("unicon_ros", "unicon_lab"): "analysis datasets fault_record recording replay report "
    "sweep transfer view",
    ("unicon_ros", "unicon_lab.recording"): "recorded_topics recorder run_recording",
    ("unicon_ros", "unicon_hardware"): "emulate peripherals",
    ("unicon_ros.cli", "unicon_lab.commands"): "analyze bag replay report_run sweep transfer view",
}
MOVED = {
    **{f"{a}.{n}": f"{b}.{n}" for (a, b), names in _NAMES.items() for n in names.split()},
    "unicon_core.blocks.controls.headset": "unicon_manipulation.teleop.operator",
    "unicon_core.blocks.joint_command": "unicon_core.blocks.postures",
    "unicon_core.blocks.retarget": "unicon_manipulation.retargeting_block",
    "unicon_core.blocks.teleop": "unicon_manipulation.teleop",
    "unicon_core.blocks.whole_body.reach": "unicon_manipulation.reach",
    "unicon_core.gap": "unicon_core.metrics",
    "unicon_core.identify": "unicon_lab.diagnose",
    "unicon_core.outlet": "unicon_core.non_blocking_writer",
    "unicon_core.platforms.kit.damping": "unicon_core.platforms.kit.command",
    "unicon_core.platforms.sim": "unicon_sims",
    "unicon_core.platforms.sim.mujoco": "unicon_core.platforms.mujoco",
    "unicon_core.policies.driven": "unicon_core.policies.policy",
    "unicon_core.registered": "unicon_base.packages",
    "unicon_core.together": "unicon_core.synchronised_start",
    "unicon_msgs_map.layout.units": "unicon_msgs_map.spec",
    "unicon_ros.bridge.tuning": "unicon_ros.parameters",
    "unicon_ros.cli.emulate": "unicon_hardware.emulate.command",
    "unicon_ros.controls": "unicon_ros.bridge.services",
    "unicon_ros.emulate.face": "unicon_hardware.endpoint",
    "unicon_ros.hardware": "unicon_hardware",
    "unicon_ros.identify": "unicon_lab.diagnose.diagnosis",
    "unicon_ros.peripherals.child": "unicon_ros.peripheral_process",
    "unicon_ros.peripherals.peripheral": "unicon_ros.peripheral",
    "unicon_ros.peripherals.webxr.frames": "unicon_hardware.peripherals.webxr.webxr",
    "unicon_ros.report.drawing": "unicon_core.drawing",
    "unicon_ros.recorded_frames": "unicon_lab.recording.recorded_topics",
    "unicon_ros.run_report": "unicon_lab.evidence_report",
    "unicon_ros.view.front": "unicon_ros.web_front",
}
"""Old module or package to new."""


class Finder:
    """Finds moved modules by their old names; no `importlib.abc`, which takes 20 ms to import."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return what loads a moved module; None for every other one."""
        loader: Any = self
        return ModuleSpec(fullname, loader) if now_at(fullname) else None

    def create_module(self, spec: ModuleSpec) -> None:
        """Leave it to the import system to make an empty module."""

    def exec_module(self, module: ModuleType) -> None:
        """Put the module that is meant in the place of an empty one."""
        old = module.__name__
        new = now_at(old)
        warnings.warn(f"{old} is {new} now; import that", DeprecationWarning, stacklevel=2)
        sys.modules[old] = import_module(new)


def now_at(name: str) -> str:
    """Return where a module is that was moved, with its package or by itself; "" for others."""
    if name.startswith(("unicon_core.", "unicon_msgs_map.", "unicon_ros.")):
        above, below = name, ""
        while above:
            if above in MOVED:
                return MOVED[above] + below
            above, _, last = above.rpartition(".")
            below = f".{last}{below}"
    return ""


def install() -> None:
    """Put the finder before the others, once."""
    if not any(isinstance(each, Finder) for each in sys.meta_path):
        finder = Finder()
        sys.meta_path.insert(0, finder)
