"""Old import paths: they lead to where a module is now, with a warning, for one release.

`import unicon_core` and `import unicon_ros` put the finder in place.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

MOVED: dict[str, str] = dict(
    map(str.split, Path(__file__).with_suffix(".txt").read_text("ascii").splitlines())
)
"""Old module or package to new: `moved.txt` has a line for each."""


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
        sys.meta_path.insert(0, Finder())
