"""`make test-changed` finds the tests of a change by what they import and name."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import pytest
from source_tree import ROOT


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    path = ROOT / "tools" / "lib" / "changed_tests.py"
    spec = importlib.util.spec_from_file_location("changed_tests", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_vendors_file_touches_the_tests_that_name_or_import_it(tool: ModuleType) -> None:
    found = tool.touched({"unicon_hardware/pnd/platform.py"})
    assert "test/hardware/test_pnd.py" in found
    assert len(found) < 60


def test_a_file_below_everything_touches_almost_all(tool: ModuleType) -> None:
    assert len(tool.touched({"unicon_base/errors.py"})) > 400
    assert len(tool.touched({"setup.py"})) >= len(tool.touched({"unicon_base/errors.py"}))


def test_a_helper_touches_the_tests_beside_it_and_a_document_none(tool: ModuleType) -> None:
    assert "test/attack/test_a05_signals.py" in tool.touched({"test/attack/runs.py"})
    assert tool.touched({"docs/tutorial.md"}) == []
