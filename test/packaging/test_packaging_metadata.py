"""The package's papers agree with each other and with the code."""

from __future__ import annotations

import ast
import re
import sys
import xml.etree.ElementTree as ElementTree
from functools import lru_cache
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from source_tree import PACKAGES, ROOT, tracked_files

import unicon_core

ROS_DEPENDS = {
    "diagnostic_msgs",
    "geometry_msgs",
    "lifecycle_msgs",
    "nav_msgs",
    "rclpy",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
}
# Private modules that come with rclpy, and modules named otherwise than their distribution.
COMES_WITH = {"_rclpy_pybind11": "rclpy", "yaml": "pyyaml", "ruamel": "rosbags"}
COMES_WITH |= {"pybullet_utils": "pybullet", "warp": "newton", "zmq": "pyzmq", "can": "python_can"}
COMES_WITH |= {"genesis": "genesis_world", "foxglove": "foxglove_sdk", "websockets": "viser"}
COMES_WITH |= {"msgspec": "viser", "zstandard": "viser"}
COMES_WITH |= {"rich": "viser", "trimesh": "viser", "PIL": "pillow"}


@lru_cache(maxsize=1)
def metadata() -> dict[str, object]:
    """Run setup.py with a `setup` that only remembers its arguments."""
    import setuptools

    seen: dict[str, object] = {}
    source = (ROOT / "setup.py").read_text(encoding="utf-8")
    original = setuptools.setup
    setuptools.setup = lambda **given: seen.update(given)
    try:
        exec(compile(source, "setup.py", "exec"), {"__file__": str(ROOT / "setup.py")})
    finally:
        setuptools.setup = original
    return seen


@lru_cache(maxsize=1)
def manifest() -> ElementTree.Element:
    return ElementTree.parse(ROOT / "package.xml").getroot()


def names(tag: str) -> set[str]:
    return {element.text or "" for element in manifest().iter(tag)}


@lru_cache(maxsize=1)
def imports() -> dict[str, set[str]]:
    """Return the top-level modules that each of our packages imports, anywhere in its files."""
    found: dict[str, set[str]] = {package: set() for package in PACKAGES}
    for name in tracked_files():
        package = name.split("/")[0]
        if package not in found or not name.endswith(".py"):
            continue
        for node in ast.walk(ast.parse((ROOT / name).read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found[package] |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                found[package].add(node.module.split(".")[0])
    return found


def is_ros(module: str) -> bool:
    return module in {"rclpy", "std_srvs", "rcl_interfaces", "builtin_interfaces"} or (
        module.endswith("_msgs") or module.startswith(("ament_", "launch"))
    )


def test_package_xml_setup_py_and_the_core_say_the_same_version() -> None:
    assert manifest().findtext("version") == metadata()["version"] == unicon_core.__version__
    map_alone = (ROOT / "unicon_msgs_map" / "pyproject.toml").read_text("utf-8")
    assert f'version = "{unicon_core.__version__}"' in map_alone


def test_package_xml_and_setup_py_agree_on_name_licence_and_maintainer() -> None:
    maintainer = manifest().find("maintainer")
    assert maintainer is not None
    assert manifest().findtext("name") == metadata()["name"] == "unicon_ros"
    assert manifest().findtext("license") == metadata()["license"] == "Apache-2.0"
    assert maintainer.text == metadata()["maintainer"]
    assert maintainer.get("email") == metadata()["maintainer_email"]


def test_package_xml_is_accepted_by_the_parser_that_colcon_uses() -> None:
    package = pytest.importorskip("catkin_pkg.package")
    warnings: list[str] = []
    parsed = package.parse_package(str(ROOT / "package.xml"), warnings=warnings)
    assert parsed.get_build_type() == "ament_python"
    assert warnings == []


def test_exec_depends_hold_the_ros_packages_of_the_bridge() -> None:
    assert names("exec_depend") >= ROS_DEPENDS


def test_every_ros_module_that_the_code_imports_is_an_exec_depend() -> None:
    used = {module for package in imports().values() for module in package if is_ros(module)}
    assert used - names("exec_depend") == set()


def test_only_packages_above_the_bridge_import_ros() -> None:
    without = (
        "unicon_base",
        "unicon_core",
        "unicon_msgs_map",
        "unicon_sims",
        "unicon_manipulation",
    )
    assert {module for package in without for module in imports()[package] if is_ros(module)} == (
        set()
    )


def test_every_other_module_that_the_code_imports_is_a_requirement_or_guarded() -> None:
    extras = metadata()["extras_require"]
    base = metadata()["install_requires"]
    assert isinstance(extras, dict)
    assert isinstance(base, list)
    declared = {
        Requirement(text).name.lower().replace("-", "_")
        for requirements in [base, *extras.values()]
        for text in requirements
    }
    used = {module for package in imports().values() for module in package}
    foreign = {
        module
        for module in used - set(PACKAGES) - set(sys.stdlib_module_names)
        if not is_ros(module) and COMES_WITH.get(module, module) not in {*declared, "rclpy"}
    }
    allowed = optional_modules() | ELSEWHERE
    assert foreign <= allowed, f"undeclared: {sorted(foreign - allowed)}"


ELSEWHERE = {"unitree_sdk2py", "controller", "isaacgym"}
"""Imported by a pipeline of the bench that runs in another interpreter, with the SDK's checkout;
modules that Webots and NVIDIA's archive bring, in no registry."""


def optional_modules() -> set[str]:
    """Return the modules that only a MissingDependencyError's install command provides."""
    named: set[str] = set()
    for name in tracked_files():
        if name.split("/")[0] in PACKAGES and name.endswith(".py"):
            text = (ROOT / name).read_text(encoding="utf-8")
            named |= set(re.findall(r"pip install '?([A-Za-z0-9_]+)", text))
    return named


def test_all_is_the_union_of_the_other_extras_but_what_is_large_or_hardware() -> None:
    extras = metadata()["extras_require"]
    assert isinstance(extras, dict)
    assert set(extras) >= {"sim", "bags", "ros", "test", "all"}
    left = {name for name in extras if name.startswith("hw-")} | {"all", "torch"}
    left |= {"sim-mjx", "sim-newton", "sim-genesis", "foxglove", "realsense", "ray"}
    left |= {"lerobot-policies"}
    united = {r for name, e in extras.items() if name not in left for r in e}
    assert set(extras["all"]) == united
    assert extras["torch"] == ["torch"]
    assert "torch" not in united


def test_the_installation_page_has_every_extra_and_says_which_are_in_all() -> None:
    extras = metadata()["extras_require"]
    assert isinstance(extras, dict)
    text = (ROOT / "docs" / "howto" / "install.md").read_text("utf-8")
    rows = re.findall(r"^\| (`[a-z-]+`(?:, `[a-z-]+`)*) \|(.*)$", text, re.MULTILINE)
    told = {name: words for names, words in rows for name in re.findall(r"[a-z-]+", names)}
    assert told.keys() == extras.keys()
    outside = {name for name, words in told.items() if "not in `all`" in words}
    every = {*extras["all"]}
    assert outside == {name for name, wanted in extras.items() if not every.issuperset(wanted)}


@pytest.mark.parametrize(
    ("machine", "python", "wanted"),
    [("x86_64", "3.12", True), ("aarch64", "3.12", False), ("x86_64", "3.15", False)],
)
def test_ros_wheels_are_asked_for_only_where_they_exist(
    machine: str, python: str, wanted: bool
) -> None:
    extras = metadata()["extras_require"]
    assert isinstance(extras, dict)
    there = {
        "sys_platform": "linux",
        "platform_machine": machine,
        "implementation_name": "cpython",
        "python_version": python,
    }
    for requirement in map(Requirement, extras["ros"]):
        assert requirement.marker is not None
        assert requirement.marker.evaluate(there) is wanted, str(requirement)


def test_every_resource_file_lands_in_data_files() -> None:
    data_files = metadata()["data_files"]
    assert isinstance(data_files, list)
    landed = {f"{to}/{Path(file).name}": file for to, files in data_files for file in files}
    for name in tracked_files():
        if name.startswith(("config/", "launch/")):
            assert landed.get(f"share/unicon_ros/{name}") == name
    assert landed["share/unicon_ros/package.xml"] == "package.xml"
    assert "share/ament_index/resource_index/packages/unicon_ros" in landed


def test_every_package_tells_type_checkers_that_it_is_typed() -> None:
    package_data = metadata()["package_data"]
    assert isinstance(package_data, dict)
    assert all("py.typed" in package_data[package] for package in PACKAGES)


def test_pyproject_has_no_project_table_that_would_break_colcon() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert re.findall(r"^\[project", text, re.MULTILINE) == []


# In two pieces, so that this file does not hold what it looks for.
FOREIGN = [
    "pypi" + r"\.org",
    "pythonhosted" + r"\.org",
    "--(extra-)?index" + "-url",
    r"(?<![\w.])/(wo" + "rk|ro" + r"ot|farm)/\w",
    r"(?<![\w.])/ho" + r"me/\w",
]


@pytest.mark.parametrize("pattern", FOREIGN)
def test_no_tracked_file_names_a_registry_host_or_a_path_of_one_machine(pattern: str) -> None:
    looked_for = re.compile(pattern)
    found = []
    for name in tracked_files():
        content = (ROOT / name).read_bytes()
        if b"\0" in content:
            continue
        for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), 1):
            if looked_for.search(line):
                found.append(f"{name}:{number}: {line.strip()[:80]}")
    assert found == []
