"""Engine `ray` without Ray: what is refused, what is shipped, and how it is found on a node."""

from __future__ import annotations

import importlib.metadata
import json
import shutil
import socket
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import pytest

from unicon_base.errors import UniconError
from unicon_base.resources import find_config, find_resource, same_modules
from unicon_lab.sweep import engines as engine
from unicon_lab.sweep.engines import Scratch
from unicon_lab.sweep.on_ray import shipment
from unicon_lab.sweep.on_ray.driver import differs
from unicon_lab.sweep.on_ray.shipment import files_of, rehearsed, to_ship
from unicon_lab.sweep.plan import Plan, code_sha256, versions
from unicon_lab.sweep.sweep_file import read_sweep
from unicon_lab.sweep.worker import RowRunner
from unicon_ros.cli.main import main

TEXT = "workflow: go2_stand\nvary: {scene.seed: {range: [0, 3]}}\n"


def sweep_file(folder: Path, text: str = TEXT) -> Path:
    (folder / "s.yaml").write_text(text, "utf-8")
    return folder / "s.yaml"


# -- what is refused -------------------------------------------------------------------------------


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main(["sweep", *map(str, arguments)]) == 1
    told = capsys.readouterr()
    assert told.err.count("\n") == 1
    return told.err.removeprefix("unicon: error: ").rstrip("\n")


def test_an_engine_that_is_none_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = refused(capsys, sweep_file(tmp_path), "--engine", "rey")
    assert told == "--engine 'rey'; did you mean 'ray'? known: batch, local, ray"
    told = refused(capsys, sweep_file(tmp_path, TEXT + "engine: rey\n"))
    assert told.endswith(
        "s.yaml:3: engine 'rey' is not known; did you mean 'ray'? known: batch, local, ray"
    )
    told = refused(capsys, sweep_file(tmp_path), "--address", "127.0.0.1:6379")
    assert told == "--address is of a Ray cluster; add --engine ray"


def test_ray_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow")
    monkeypatch.setattr(engine.importlib.util, "find_spec", lambda name: None)
    told = refused(capsys, sweep_file(tmp_path, TEXT + "engine: ray\n"), "--out", tmp_path / "o")
    assert told == "unicon sweep --engine ray needs ray: pip install 'unicon_ros[ray]'"
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    "address", ["127.0.0.1", "6379", "ray://127.0.0.1:10001", ":1", "a:0", "a:70000", "a:b"]
)
def test_an_address_that_is_none_is_told(address: str) -> None:
    with pytest.raises(UniconError) as told:
        engine.environment_for(address)
    assert str(told.value) == (
        f"--address {address!r}: give HOST:PORT of a Ray head node, such as 127.0.0.1:6379, on a "
        "machine that is a node of the cluster"
    )


def test_an_address_where_nobody_is_is_told() -> None:
    with socket.socket() as taken:  # bound, and nobody listens
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(UniconError) as told:
            engine.environment_for(address)
    assert str(told.value) == (
        f"--address {address}: no Ray cluster is there (Connection refused); start one with ray "
        "start --head, or leave --address out"
    )


def test_a_node_with_another_version_or_other_code_is_told() -> None:
    here: dict[str, Any] = {"versions": versions(), "code": code_sha256()}
    assert differs(here) == ""
    old = {"versions": versions() | {"numpy": "1.0"}, "code": code_sha256()}
    assert differs(old) == (
        f"has numpy 1.0 (here {versions()['numpy']}): rows would differ; install the same there"
    )
    old["versions"].pop("numpy")
    assert differs(old).startswith("has numpy absent (here ")
    assert differs(here | {"code": "0"}) == (
        "runs other code of unicon_ros than was shipped: rows would differ; take unicon_ros out of "
        "PYTHONPATH there"
    )


@pytest.mark.parametrize(
    ("package", "message"),
    [
        (
            "import not_there_either",
            "ray cannot be imported: No module named 'not_there_either'; pip install "
            "'unicon_ros[ray]' mends it",
        ),
        (
            "import os\nprint('no', 'luck', flush=True)\nos._exit(3)",
            "ray: Ray did not start: no luck; mend it (all that it said is in {log}), or try "
            "--engine local",
        ),
    ],
)
def test_a_ray_that_does_not_work_is_told_for_what_it_is(
    package: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray" / "__init__.py").write_text(package, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(engine, "files_of", lambda *_: [])
    plan = Plan(read_sweep(sweep_file(tmp_path)))
    rows = engine.RayEngine(plan, 1, 4, tmp_path)
    try:
        with pytest.raises(UniconError) as told:
            list(rows.run(plan))
    finally:
        rows.close()
    assert str(told.value) == message.format(log=tmp_path / "ray.log")


# -- what is shipped -------------------------------------------------------------------------------


def test_the_rehearsal_has_every_word_that_is_varied(tmp_path: Path) -> None:
    text = "workflow: go2_stand\nset: {duration: 1}\nrepeat: 2\n"
    text += "vary: {scene.delay: [0, 1], platform: [mujoco, fake], scene.noise: [null, {}]}\n"
    plan = Plan(read_sweep(sweep_file(tmp_path, text)))
    rows = [settings[2:4] for settings in rehearsed(plan)]
    first = ("platform=mujoco", "scene.noise=null")
    assert rows == [first, first, ("platform=fake", first[1]), (first[0], "scene.noise={}")]


WORKFLOW = """\
robot: go2
platform: mujoco
rate: 50
duration: 1
safety: [finite, joint_limits]
policies: {walk: ./policies/link}
commands: [{call: 'shipped_blocks:quiet'}]
flow: {policy: walk}
scene: {initial_pose: 'policy:walk'}
"""
BLOCKS = """\
from unicon_core.flow import Tick
from shipped_words import NOTHING


def quiet() -> Tick:
    return lambda: NOTHING
"""
NODE = """\
import json, os, sys
from pathlib import Path
from unicon_lab.sweep.on_ray.driver import RowActor
told = json.loads(sys.stdin.read())
actor = RowActor(told["manifest"])
print(json.dumps([actor.hello(), [actor.row(each)["row"] for each in told["rows"]]]))
"""


def test_packages_that_pip_put_elsewhere_are_the_nodes_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("half/__init__.py", "half.libs/lib.so", "one.py", "half-1.0.dist-info/METADATA")
    mine = ("mine.py", "edited.py", "edited.egg-info/SOURCES.txt", "data.yaml")
    for name in (*names, *mine):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("edited.py\n" if "SOURCES" in name else "", "utf-8")
    record = "".join(f"{name},,\n" for name in (*names, "../bin/half"))
    (tmp_path / "half-1.0.dist-info" / "RECORD").write_text(record, "utf-8")
    every = [str(tmp_path / name) for name in (*names, *mine)]
    assert to_ship(every) == sorted(every)  # no folder of packages: files like any others
    monkeypatch.syspath_prepend(str(tmp_path))
    assert to_ship(every) == sorted(str(tmp_path / name) for name in mine)


@pytest.mark.slow  # 4 s in three processes
def test_a_node_without_the_files_has_the_same_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    mine, other, node = tmp_path / "mine", tmp_path / "other", tmp_path / "node"
    (mine / "policies").mkdir(parents=True)
    shutil.copytree(find_resource("policies/go2_velocity", "policy"), other / "walk")
    (mine / "policies" / "link").symlink_to(other / "walk")
    (mine / "workflow.yaml").write_text(WORKFLOW)
    (mine / "shipped_blocks.py").write_text(BLOCKS)
    (mine / "shipped_words.py").write_text("NOTHING = False\n")
    text = "workflow: ./workflow.yaml\nduration: 0.1\nvary:\n"
    text += f"  policies.walk: [./policies/link, '{other}/walk', ./nowhere]\n"
    text += "  scene.seed: [0, 1]\n"
    monkeypatch.chdir(mine)
    monkeypatch.syspath_prepend(str(mine))
    plan = Plan(read_sweep(sweep_file(mine, text)))
    runner = RowRunner(plan.task())
    rows = [list(row.settings) for row in plan]
    here = [runner(settings)["row"] for settings in rows]
    runner.programs.close()
    assert [row["outcome"] for row in here] == ["duration"] * 4 + ["refused"] * 2
    files = files_of(plan, tmp_path / "log")
    shipment.pack(tmp_path / "a.zip", files)
    shipment.pack(tmp_path / "b.zip", files)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    told = json.dumps({"manifest": shipment.manifest(plan.task()), "rows": rows})
    zipfile.ZipFile(tmp_path / "a.zip").extractall(node)
    environment = same_modules() | {"PYTHONPATH": str(node)}
    monkeypatch.chdir(tmp_path)
    shutil.rmtree(mine)
    shutil.rmtree(other)
    done = subprocess.run(
        [sys.executable, "-c", NODE],
        cwd=node, env=environment, input=told, capture_output=True, text=True, check=True,
    )  # fmt: skip
    hello, there = json.loads(done.stdout)
    assert there == here
    assert differs(hello) == ""


def test_an_absolute_path_is_its_copy_where_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, node = tmp_path / "mine", tmp_path / "node"
    copy = node / str(mine).lstrip("/")
    copy.mkdir(parents=True)
    mine.mkdir()
    monkeypatch.setenv("UNICON_COPIES", str(node))
    for name in ("robot.yaml", "other.yaml"):
        (mine / name).touch()
    (copy / "robot.yaml").touch()
    assert find_config("robots", mine / "robot.yaml") == copy / "robot.yaml"
    assert find_resource(mine / "robot.yaml", "model") == copy / "robot.yaml"
    assert find_resource(mine / "other.yaml", "model") == mine / "other.yaml"


def test_what_cannot_be_shipped_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UniconError, match=r"cannot ship .*gone: No such file.*; correct it"):
        shipment.pack(tmp_path / "a.zip", [str(tmp_path / "gone")])
    with pytest.raises(UniconError, match=r"cannot write .*: No space left .*, or set TMPDIR"):
        shipment.pack(Path("/dev/full"), [])
    monkeypatch.setattr(shipment, "MOST_BYTES", 2_000_000)
    with pytest.raises(UniconError, match=r"more than 2 MB of files .* ship; use --engine local"):
        shipment.pack(tmp_path / "a.zip", [])


def test_a_scratch_folder_outlives_its_owner_only_until_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    code = "import os\nfrom unicon_lab.sweep.engines import Scratch\nScratch()\n"
    subprocess.run(
        [sys.executable, "-c", code + "os.kill(os.getpid(), 9)"],
        env=same_modules() | {"TMPDIR": str(tmp_path)}, check=False,
    )  # fmt: skip
    (left,) = tmp_path.iterdir()
    first, second = Scratch(), Scratch()
    assert not left.exists()
    assert first.path.exists()
    first.close()
    second.close()
    assert not list(tmp_path.iterdir())


def test_an_archive_has_what_we_register(tmp_path: Path) -> None:
    """A node without us finds blocks and platforms of other packages of ours by it."""
    archive = tmp_path / "files.zip"
    shipment.pack(archive, [])
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(tmp_path / "there")
    there = [*importlib.metadata.distributions(path=[str(tmp_path / "there")])]
    [ours] = [each for each in there if each.metadata["Name"].replace("-", "_") == "unicon_ros"]
    registered = {(entry.group, entry.name) for entry in ours.entry_points}
    packages = {path.parent.name for path in shipment._SOURCE.glob("unicon_*/__init__.py")}
    assert packages == {*shipment.PACKAGES}
    assert {("unicon.platforms", "pybullet"), ("unicon.blocks", "reach")} <= registered
