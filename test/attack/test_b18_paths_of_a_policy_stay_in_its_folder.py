"""B18: a data file names files in its own folder; only a workflow may name any path."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from attack_files import REPOSITORY

from unicon_base.errors import PolicyError, RobotError
from unicon_core.policies import load_policy
from unicon_core.policies.facts import Facts
from unicon_core.policies.policy_yaml import write_partial_yaml
from unicon_core.robots import load_robot

GO2 = REPOSITORY / "config" / "policies" / "go2_velocity"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A policy in a folder, and the same network outside of it."""
    inside = tmp_path / "inside"
    inside.mkdir()
    for name in ("policy.yaml", "policy.onnx"):
        shutil.copyfile(GO2 / name, inside / name)
    shutil.copyfile(GO2 / "policy.onnx", tmp_path / "outside.onnx")
    (tmp_path / "there").mkdir()
    shutil.copyfile(GO2 / "policy.onnx", tmp_path / "there" / "policy.onnx")
    return inside


def name_network(folder: Path, text: str) -> None:
    path = folder / "policy.yaml"
    path.write_text(path.read_text("utf-8").replace("onnx: policy.onnx", f"onnx: {text}"), "utf-8")


@pytest.mark.parametrize(
    "name",
    ["../outside.onnx", "sub/../../outside.onnx", "ABSOLUTE", "../inside/policy.onnx", "~/x"],
)
def test_a_path_that_leads_out_is_refused(name: str, folder: Path) -> None:
    name_network(folder, name.replace("ABSOLUTE", str(folder.parent / "outside.onnx")))
    with pytest.raises(PolicyError, match=r"is not in the folder|no such") as caught:
        load_policy(folder)
    assert f"{folder / 'policy.yaml'}:5" in str(caught.value) or "no such" in str(caught.value)


def test_a_link_that_leads_out_is_refused(folder: Path) -> None:
    (folder / "link.onnx").symlink_to(folder.parent / "outside.onnx")
    name_network(folder, "link.onnx")
    with pytest.raises(PolicyError, match="is not in the folder"):
        load_policy(folder)


def test_a_folder_that_is_a_link_out_is_refused(folder: Path) -> None:
    (folder / "sub").symlink_to(folder.parent / "there")
    name_network(folder, "sub/policy.onnx")
    with pytest.raises(PolicyError, match="is not in the folder"):
        load_policy(folder)


def test_a_link_to_itself_is_refused(folder: Path) -> None:
    (folder / "loop.onnx").symlink_to(folder / "loop.onnx")
    name_network(folder, "loop.onnx")
    with pytest.raises(PolicyError):
        load_policy(folder)


def test_files_in_the_folder_and_below_are_found(folder: Path) -> None:
    (folder / "sub").mkdir()
    shutil.move(folder / "policy.onnx", folder / "sub" / "policy.onnx")
    name_network(folder, "sub/policy.onnx")
    assert load_policy(folder).model.is_file()


def test_a_folder_of_links_as_colcon_makes_it_is_read(folder: Path) -> None:
    installed = folder.parent / "installed"
    installed.mkdir()
    for name in ("policy.yaml", "policy.onnx"):
        (installed / name).symlink_to(folder / name)
    assert load_policy(installed).model == installed / "policy.onnx"


def test_a_workflow_may_name_any_network(folder: Path) -> None:
    path = folder / "policy.yaml"
    text = path.read_text("utf-8").replace("onnx: policy.onnx\n", "")
    path.write_text(text, "utf-8")
    given = {"onnx": str(folder.parent / "outside.onnx")}
    assert load_policy(folder, given=given).model == folder.parent / "outside.onnx"


def test_an_import_copies_no_file_from_outside(folder: Path) -> None:
    facts = Facts(folder / "policy.yaml", "policy.yaml", {"onnx": "../outside.onnx"})
    with pytest.raises(PolicyError, match="is not in the folder"):
        write_partial_yaml(facts, {}, folder.parent / "out")


@pytest.mark.parametrize(
    "model", ["/etc/passwd", "../x.xml", "assets:../x.xml", "~/x.xml", "a/../../b"]
)
def test_the_model_of_a_robot_file_does_not_lead_out(model: str, tmp_path: Path) -> None:
    text = (REPOSITORY / "config" / "robots" / "go2.yaml").read_text("utf-8")
    path = tmp_path / "go2.yaml"
    path.write_text(text.replace("models/go2/go2.xml", model), "utf-8")
    with pytest.raises(RobotError, match="leads out of its folder"):
        load_robot(path)
