"""Broken variants of other people's policies and ours: each is refused, its culprit named.

Most are found without a run; those that only a run can show are marked slow, but for the two that
are found soonest: each is told by the same comparison of runs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mujoco", reason="the checks are run on a model")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")
pytest.importorskip("onnx", reason="the variants are written with onnx")

from broken_variants import VARIANTS, WORKFLOWS, Draft, Variant

from unicon_core.check import CheckResult, check_workflow
from unicon_core.workflow.document import workflow_names

_STATIC = [variant for variant in VARIANTS if not variant.twin]
_TWIN = [variant for variant in VARIANTS if variant.twin]
_QUICK = {"mjlab": "terms_order", "holosoma": "training_order"}


def slow(value: str) -> Any:
    """Return a parameter of a test that `make test-slow` runs."""
    return pytest.param(value, marks=pytest.mark.slow)


def _name(variant: Variant) -> str:
    return f"{variant.policy}-{variant.name}"


def assert_named(result: CheckResult, variant: Variant) -> None:
    """The first finding names the culprit; what cannot be built has it in the error's text."""
    assert result.findings, result.text()
    first = result.findings[0]
    told = first.evidence if first.code == "build" else first.culprit
    assert variant.culprit in told, result.text()
    assert all(finding.remedy for finding in result.findings), result.text()


@pytest.mark.parametrize("variant", _STATIC, ids=_name)
def test_a_mistake_is_found_without_a_run(variant: Variant, tmp_path: Path, assets: Path) -> None:
    assert_named(check_workflow(variant.write(tmp_path / "v", assets)), variant)


def _run(variant: Variant, folder: Path, assets: Path) -> None:
    path = variant.write(folder, assets)
    assert check_workflow(path).clean  # else it need not be run
    assert_named(check_workflow(path, twin=True), variant)


@pytest.mark.parametrize("policy", ["holosoma", slow("mjlab")])
def test_a_mistake_is_found_in_the_twin(policy: str, tmp_path: Path, assets: Path) -> None:
    variant = next(v for v in _TWIN if (v.policy, v.name) == (policy, _QUICK[policy]))
    _run(variant, tmp_path / "v", assets)


@pytest.mark.slow
@pytest.mark.parametrize("variant", [v for v in _TWIN if _QUICK.get(v.policy) != v.name], ids=_name)
def test_every_mistake_is_found_in_the_twin(variant: Variant, tmp_path: Path, assets: Path) -> None:
    _run(variant, tmp_path / "v", assets)


NAMES = sorted({*WORKFLOWS.values()} - {"rover_drive", "g1_dance"})  # are run as copies


@pytest.mark.parametrize("name", [slow(n) if n == "g1_holosoma" else n for n in NAMES])
def test_the_good_ones_raise_no_alarm(name: str, assets: Path) -> None:
    result = check_workflow(name, twin=True)
    assert result.clean, result.text()
    scores = [float(row[2]) for row in _twin_rows(result) if row[2]]
    assert scores[0] > 0.7
    assert max(scores[1:]) < scores[0] - 0.25


@pytest.mark.parametrize("policy", ["filtered", slow("rover"), "dance"])
def test_right_copies_raise_no_alarm_in_the_twin(policy: str, tmp_path: Path, assets: Path) -> None:
    result = check_workflow(Draft(policy, tmp_path / "copy", assets).write(), twin=True)
    assert result.clean, result.text()
    assert float(_twin_rows(result)[0][2]) > 0.85


@pytest.mark.slow
@pytest.mark.parametrize("name", workflow_names())
def test_no_contract_of_a_shipped_workflow_raises_an_alarm(
    name: str, assets: Path, at_hand: Callable[[str], None]
) -> None:
    """A flow by itself may fall: of h1_stand nobody keeps the balance, g1_buttons is limp."""
    at_hand(name)
    result = check_workflow(name, ["check.duration=5"], twin=True)
    assert not [each for each in result.findings if each.culprit != "flow"], result.text()


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("speed", [0.5, 0.8])
@pytest.mark.parametrize("duration", [4, 8])
def test_the_good_ones_raise_no_alarm_at_other_speeds(
    name: str, speed: float, duration: int, assets: Path
) -> None:
    changes = [f"check.duration={duration}", f"check.command=[{speed}, 0.0, 0.0]"]
    result = check_workflow(name, changes, twin=True)
    assert result.clean, result.text()


def _twin_rows(result: CheckResult) -> tuple[tuple[str, ...], ...]:
    return next(s.rows for s in result.sections if s.title.startswith("Twin on platform mujoco"))


def test_there_are_a_hundred_variants_and_ten_or_more_of_each_policy() -> None:
    assert len({(variant.policy, variant.name) for variant in VARIANTS}) == len(VARIANTS) >= 100
    for policy in WORKFLOWS:
        assert len([variant for variant in VARIANTS if variant.policy == policy]) >= 5


@pytest.mark.parametrize("policy", sorted(WORKFLOWS))
def test_an_unchanged_copy_is_clean(policy: str, tmp_path: Path, assets: Path) -> None:
    result = check_workflow(Draft(policy, tmp_path / "copy", assets).write())
    assert result.clean, result.text()
