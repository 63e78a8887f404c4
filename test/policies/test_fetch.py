"""`unicon policies fetch`: pinned, whole or not at all, over its own library's protocol."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from hub_server import COMMIT, Hub
from policy_helpers import toy_values, write_linear, write_toy

from unicon_base.errors import MissingDependencyError, PolicyError, UniconError
from unicon_base.resources import same_modules, sha256_of
from unicon_core.policies import load_policy
from unicon_core.policies.fetch import fetch_policy
from unicon_ros.cli.main import main

HUB = pytest.mark.skipif(
    importlib.util.find_spec("huggingface_hub") is None,
    reason="not tried over HTTP: pip install huggingface_hub",
)


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    write_toy(tmp_path / "walk")
    return tmp_path / "walk"


def left(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_file_is_pinned_and_what_is_there_stays(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, digest = tmp_path / "out" / "mine", sha256_of(walk / "policy.onnx")
    words = ["policies", "fetch", walk.as_uri(), "--out", str(out)]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert f"sha256 {digest}  policy.onnx" in told
    assert f"{out}/policy.yaml" in told
    values = yaml.safe_load((out / "policy.yaml").read_text())
    assert values["sha256"] == digest
    assert values["sources"] == {"fetched": walk.as_uri()}
    assert load_policy(out).name == "toy"
    assert main(words) == 1
    assert f"{out} is there; give another --out, or replace it: --force" in capsys.readouterr().err

    write_linear(walk / "policy.onnx", 15, 4, weight=np.ones((15, 4), np.float32))
    assert main([*words, "--force", "--sha256", digest]) == 1
    assert "nothing was written" in capsys.readouterr().err
    assert sha256_of(out / "policy.onnx") == digest
    assert main([*words, "--force", "--sha256", sha256_of(walk / "policy.onnx").upper()]) == 0
    assert sha256_of(out / "policy.onnx") != digest
    assert left(out.parent) == {"mine"}
    assert left(out) == {"policy.yaml", "policy.onnx"}


def test_another_network_in_its_place_is_refused_from_then_on(walk: Path, tmp_path: Path) -> None:
    fetch_policy(walk.as_uri(), tmp_path / "mine")
    write_linear(tmp_path / "mine" / "policy.onnx", 15, 4, weight=np.ones((15, 4), np.float32))
    with pytest.raises(PolicyError, match="it is not the network that this contract was written"):
        load_policy(tmp_path / "mine")


def test_a_network_without_facts_is_pinned_too(walk: Path, tmp_path: Path) -> None:
    (walk / "policy.yaml").unlink()
    report = fetch_policy((walk / "policy.onnx").as_uri(), tmp_path / "mine")
    assert "period" in report.report.missing
    values = yaml.safe_load((tmp_path / "mine" / "policy.yaml").read_text())
    assert values["sha256"] == report.sha256["policy.onnx"] == sha256_of(walk / "policy.onnx")


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("walk", "give hf://OWNER/REPO, wandb://ENTITY/PROJECT/RUN, file:///PATH"),
        ("https://somewhere/policy.onnx", "give hf://OWNER/REPO"),
        ("hf://someone", "give hf://OWNER/REPO[@REVISION][/PATH]"),
        ("hf://someone/walks/../../x", "leave out '.' and '..'"),
        ("wandb://me/project", "give wandb://ENTITY/PROJECT/RUN"),
        ("file://other/walk", "a file of this machine has three slashes"),
        ("file:///no/such/walk", "no such file or folder /no/such/walk"),
    ],
)
def test_what_cannot_be_had_is_one_line(url: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(PolicyError) as caught:
        fetch_policy(url, tmp_path / "mine")
    assert told in str(caught.value)
    assert left(tmp_path) == set()


def test_only_a_policy_is_replaced(walk: Path, tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    (home / "letters").write_text("dear")
    with pytest.raises(PolicyError, match="is not the folder of a policy"):
        fetch_policy(walk.as_uri(), home, force=True)
    (tmp_path / "link").symlink_to(walk)
    with pytest.raises(PolicyError, match="is not the folder of a policy"):
        fetch_policy(walk.as_uri(), tmp_path / "link", force=True)
    with pytest.raises(PolicyError, match="give the 64 digits"):
        fetch_policy(walk.as_uri(), tmp_path / "mine", sha256="abc")
    (tmp_path / "file").write_text("")
    with pytest.raises(UniconError, match=r"cannot write .*; give another --out"):
        fetch_policy(walk.as_uri(), tmp_path / "file" / "mine")
    assert left(tmp_path) == {"home", "link", "walk", "file"}


@pytest.mark.parametrize(
    ("url", "module", "install"),
    [
        ("hf://someone/walks", "huggingface_hub", "pip install huggingface_hub"),
        ("wandb://me/walks/abc123", "wandb", "pip install wandb"),
    ],
)
def test_an_absent_library_is_named(
    url: str, module: str, install: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError, match=install):
        fetch_policy(url, tmp_path / "mine")
    assert left(tmp_path) == set()


@pytest.fixture
def hub(walk: Path) -> Iterator[Hub]:
    values = yaml.safe_dump(toy_values(name="other")).encode()
    network = (walk / "policy.onnx").read_bytes()
    made = Hub(
        {
            "README.md": b"# walks",
            "policy.yaml": (walk / "policy.yaml").read_bytes(),
            "policy.onnx": network,
            "other/policy.yaml": values,
            "other/policy.onnx": network,
            "other/large.safetensors": b"0" * 1000,
        }
    )
    yield made
    made.close()


def fetched(hub: Hub, where: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Fetch by a process of its own: huggingface_hub reads its endpoint when it is imported."""
    environment = {
        **same_modules(),
        "HF_ENDPOINT": hub.url,
        "HF_HOME": str(where / "hf"),
        "HF_HUB_DISABLE_XET": "1",
        "HF_HUB_DISABLE_TELEMETRY": "1",
        "NO_PROXY": "127.0.0.1",
    }
    command = [sys.executable, "-m", "unicon_ros", "policies", "fetch", *words]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=50, check=False
    )


@HUB
def test_a_repository_is_fetched_at_one_commit(hub: Hub, walk: Path, tmp_path: Path) -> None:
    digest = sha256_of(walk / "policy.onnx")
    out = tmp_path / "got" / "mine"
    done = fetched(hub, tmp_path, "hf://someone/walks@v1/other", "--out", str(out))
    assert done.returncode == 0, done.stderr
    assert f"fetched hf://someone/walks@{COMMIT}/other" in done.stdout
    assert f"sha256 {digest}  policy.onnx" in done.stdout
    assert load_policy(out).name == "other"
    values = yaml.safe_load((out / "policy.yaml").read_text())
    assert values["sources"] == {"fetched": f"hf://someone/walks@{COMMIT}/other"}
    files = {path.partition("/resolve/")[2] for path in hub.asked if "/resolve/" in path}
    assert files == {f"{COMMIT}/other/policy.yaml", f"{COMMIT}/other/policy.onnx"}
    assert left(out.parent) == {"mine"}


@HUB
@pytest.mark.slow
def test_what_the_hub_lacks_or_changes_is_one_line(hub: Hub, tmp_path: Path) -> None:
    out = str(tmp_path / "mine")
    for words, told in (
        (("hf://someone/runs",), "huggingface_hub cannot get it"),
        (("hf://someone/walks/none",), "nothing of a policy is under 'none'"),
        (("hf://someone/walks/policy.onnx", "--sha256", "0" * 64), "nothing was written"),
    ):
        done = fetched(hub, tmp_path, *words, "--out", out)
        assert done.returncode == 1, done.stdout
        assert told in done.stderr
        assert "Traceback" not in done.stderr
        assert done.stderr.splitlines()[-1].startswith("unicon: error: hf://someone/")
        assert not os.path.lexists(out)
    done = fetched(hub, tmp_path, "hf://someone/walks/policy.onnx", "--out", out)
    assert done.returncode == 0, done.stderr
    assert load_policy(out).name == "toy"
    hub.files["../evil.onnx"] = b""
    done = fetched(hub, tmp_path, "hf://someone/walks", "--out", f"{out}2")
    assert "leads out of its folder" in done.stderr
