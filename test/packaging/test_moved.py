"""Old import paths lead to where modules are now, with a warning, and load nothing twice."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

import pytest
from source_tree import ROOT

from unicon_base.moved import MOVED, now_at

SCRIPT = """
import sys, warnings
from importlib import import_module
import unicon_core, unicon_ros
for old, new in zip(sys.argv[1::2], sys.argv[2::2]):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert import_module(old) is import_module(new), old
    assert any(f"is {new} now" in str(each.message) for each in told), old
"""


def test_every_module_that_moved_is_found_by_its_old_name() -> None:
    names = {**MOVED, "unicon_ros.hardware.unitree.platform": "unicon_hardware.unitree.platform"}
    words = [word for pair in names.items() for word in pair]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *words], cwd=ROOT, capture_output=True, text=True, timeout=90
    )
    assert done.returncode == 0, done.stderr


def test_other_names_are_left_alone() -> None:
    assert now_at("unicon_core.states") == now_at("unicon_ros.hardware_of_mine") == ""
    assert now_at("unicon_core.errors.nope") == "unicon_base.errors.nope"
    assert find_spec("unicon_core.nope") is None
    with pytest.raises(ModuleNotFoundError):
        import_nothing()


def import_nothing() -> None:
    import unicon_ros.hardware.nope  # noqa: F401
