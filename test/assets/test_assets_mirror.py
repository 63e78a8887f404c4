"""A G1 from an empty home: fetched over loopback from a mirror of its public files, it walks."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from unicon_core.assets.manifest import load_assets, named

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
pytest.importorskip("onnxruntime", reason="pip install 'unicon_ros[sim]'")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

SHARED = Path(__file__).resolve().parents[2].parent / "shared"
CLI = "import sys; from unicon_ros.cli.main import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def mirror(tmp_path: Path) -> Iterator[str]:
    """Serve the G1's files, of those at hand beside the checkout, as a mirror has them."""
    if not (SHARED / "asset-mirror").is_dir():
        pytest.skip("no files of the G1 are at hand: ../shared/asset-mirror")
    there = {}
    for folder in ("asset-mirror/g1_29dof", "assets/policies/g1_velocity_mjlab", "assets/licenses"):
        for path in (SHARED / folder).rglob("*"):
            if path.is_file():
                there[hashlib.sha256(path.read_bytes()).hexdigest()] = path
    for asset in named(["g1"], load_assets()):
        for file in asset.files:
            link = tmp_path / "mirror" / asset.name / file.mirrored
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(there[file.sha256])
    handler = functools.partial(_Quiet, directory=str(tmp_path / "mirror"))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""


def test_a_g1_is_fetched_and_walks_with_its_body(mirror: str, tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    kept = {k: v for k, v in os.environ.items() if not k.startswith("XDG_")}
    environment = {**kept, "HOME": str(home), "UNICON_ASSETS": str(tmp_path / "none")}

    def unicon(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", CLI, *arguments],
            cwd=home,
            env=environment,
            capture_output=True,
            text=True,
            timeout=200,
        )

    refused = unicon("run", "g1_walk", "--speed", "max", "--duration", "1")
    assert refused.returncode == 1
    assert "get it: unicon assets fetch g1_velocity_mjlab" in refused.stderr
    fetched = unicon("assets", "fetch", "g1", "--from", mirror)
    assert fetched.returncode == 0, fetched.stderr
    assert "licence BSD-3-Clause" in fetched.stdout
    assert "licence Apache-2.0" in fetched.stdout
    report = home / "walk.json"
    walked = unicon(
        *("run", "g1_walk", "--speed", "max", "--duration", "10", "--report", str(report))
    )
    assert walked.returncode == 0, walked.stderr
    assert "absent" not in walked.stderr  # every mesh is there
    told = json.loads(report.read_text("utf-8"))
    assert not told["fell"]
    assert told["base_displacement_m"][0] >= 3.0
    assert unicon("assets", "verify", "g1").returncode == 0
