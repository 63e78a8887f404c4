"""`unicon assets`: what is fetched is whole and as listed, or is not there."""

from __future__ import annotations

import hashlib
import json
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from unicon_base.errors import UniconError
from unicon_base.resources import find_resource
from unicon_core.assets.fetching import fetch
from unicon_core.assets.manifest import Asset, load_assets, named, wrong_files
from unicon_ros.cli.main import main

FILES = {
    "LICENSES/owner.txt": b"do as you like",
    "cube.xml": b"<mujoco/>",
    "meshes/cube.stl": bytes(range(256)) * 2000,
}
COMMIT = "0123456789abcdef0123456789abcdef01234567"


def listed(files: dict[str, bytes], licence: str = "MIT") -> dict[str, Any]:
    rows = {
        name: [0, f"there/{name}", len(data), hashlib.sha256(data).hexdigest()]
        for name, data in files.items()
    }
    source = {"repository": "owner/cubes", "commit": COMMIT, "licence": licence}
    return {"kind": "model", "sources": [source], "files": rows}


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home of its own, a list with the asset `cube`, and a mirror folder that has it."""
    config, mirror = tmp_path / "config", tmp_path / "mirror"
    config.mkdir()
    write_list(config, {"cube": listed(FILES), "other": listed(FILES, "GPL-3.0-only")})
    for name in ("cube", "other"):
        for file, data in FILES.items():
            path = mirror / name / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
    monkeypatch.setenv("UNICON_PATH", str(config))
    monkeypatch.setenv("UNICON_ASSETS", str(tmp_path / "none"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "unicon" / "assets"


def write_list(config: Path, values: Any) -> None:
    (config / "assets.yaml").write_text(
        "\n".join(f"{name}:\n  {json.dumps(value)}" for name, value in values.items()), "utf-8"
    )


def cube() -> Asset:
    return named(["cube"], load_assets())[0]


class Server(ThreadingHTTPServer):
    """A mirror over HTTP that misbehaves as it is asked to.

    Attributes:
        cut: bytes of a body after which the connection ends, once for each path.
        stall: bytes of a body after which nothing comes any more.
        whole: it knows no ranges.
        piece: bytes that are sent at once.
        pace: seconds between pieces.
        asked: paths and ranges in the order in which they came.
    """

    daemon_threads = True
    cut = stall = 0
    whole = False
    pace, piece = 0.0, 1 << 16

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.folder, self.asked, self.was_cut = folder, [], set[str]()
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"


class _Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:  # the name that http.server asks for
        server, begin = self.server, 0
        told = self.headers.get("Range", "")
        server.asked.append((self.path, told))
        path = server.folder / self.path.lstrip("/")
        if not path.is_file():
            self.send_error(404)
            return
        body = path.read_bytes()
        if told and not server.whole:
            begin = int(told.removeprefix("bytes=").rstrip("-"))
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {begin}-{len(body) - 1}/{len(body)}")
        else:
            self.send_response(200)
        self.send_header("Content-Length", str(len(body) - begin))
        self.end_headers()
        body = body[begin:]
        if server.stall and len(body) > server.stall:
            self.wfile.write(body[: server.stall])
            self.wfile.flush()
            time.sleep(3.0)
            return
        if server.cut and self.path not in server.was_cut and len(body) > server.cut:
            server.was_cut.add(self.path)
            body = body[: server.cut]
        for k in range(0, len(body), server.piece):
            self.wfile.write(body[k : k + server.piece])
            time.sleep(server.pace)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    served = Server(tmp_path / "mirror")
    yield served
    served.shutdown()
    served.server_close()


def everything(cache: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(cache)): path.read_bytes()
        for path in sorted(cache.rglob("*"))
        if path.is_file() and path.suffix != ".lock"
    }


WHOLE = {f"models/cube/{name}": data for name, data in FILES.items()}


def test_a_folder_and_a_server_give_the_same_and_a_second_time_nothing_comes(
    cache: Path, server: Server, tmp_path: Path
) -> None:
    with pytest.raises(UniconError, match="get it: unicon assets fetch cube"):
        find_resource("assets:models/cube/cube.xml", "model")
    got = fetch(cube(), mirror=server.url)
    assert got.fetched == cube().size
    assert everything(cache) == WHOLE
    assert find_resource("assets:models/cube/cube.xml", "model") == got.folder / "cube.xml"
    assert server.asked[0][0] == "/cube/LICENSES/owner.txt"
    asked = len(server.asked)
    assert fetch(cube(), mirror=server.url).fetched == 0
    assert len(server.asked) == asked
    fetch(named(["other"], load_assets())[0], mirror=tmp_path / "mirror")
    assert everything(cache) == WHOLE | {f"models/other/{k}": v for k, v in FILES.items()}


def test_the_folder_that_the_user_names_wins(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetch(cube(), mirror=tmp_path / "mirror")
    own = tmp_path / "none" / "models" / "cube"
    own.mkdir(parents=True)
    (own / "cube.xml").write_text("<mujoco model='mine'/>", "utf-8")
    assert find_resource("assets:models/cube/cube.xml", "model") == own / "cube.xml"
    assert find_resource("assets:models/cube/meshes/cube.stl", "mesh").is_relative_to(cache)


def test_a_connection_that_is_cut_goes_on_where_it_ended(cache: Path, server: Server) -> None:
    server.cut = 200_000
    fetch(cube(), mirror=server.url)
    assert everything(cache) == WHOLE
    assert server.asked[-1] == ("/cube/meshes/cube.stl", "bytes=200000-")


def test_a_server_without_ranges_sends_all_again(cache: Path, server: Server) -> None:
    server.cut, server.whole = 200_000, True
    fetch(cube(), mirror=server.url)
    assert everything(cache) == WHOLE


def test_a_server_that_stalls_is_given_up_and_what_came_stays_for_the_next_try(
    cache: Path, server: Server
) -> None:
    server.stall = 150_000
    began = time.monotonic()
    with pytest.raises(UniconError, match="nothing for too long; fetch again: it goes on where"):
        fetch(cube(), mirror=server.url, silence=0.2)
    assert time.monotonic() - began < 20.0
    assert not (cache / "models").exists()
    server.stall = 0
    assert fetch(cube(), mirror=server.url).fetched < cube().size
    assert everything(cache) == WHOLE
    begun = [asked for path, asked in server.asked if path.endswith("cube.stl")]
    assert begun[-1] == "bytes=300000-"


def test_a_file_may_have_another_name_on_a_mirror(
    cache: Path, server: Server, tmp_path: Path
) -> None:
    told = listed(FILES)
    told["files"]["here/cube.xml"] = [*told["files"].pop("cube.xml"), "cube.xml"]
    write_list(tmp_path / "config", {"cube": told})
    folder = fetch(cube(), mirror=server.url).folder
    assert (folder / "here" / "cube.xml").read_bytes() == FILES["cube.xml"]
    told["files"]["here/cube.xml"][-1] = "../cube.xml"
    write_list(tmp_path / "config", {"cube": told})
    with pytest.raises(UniconError, match="paths without"):
        load_assets()


def test_a_server_that_drips_is_given_up(cache: Path, server: Server) -> None:
    server.piece, server.pace = 64, 0.02  # 640 bytes in the time in which 4 KiB have to come
    with pytest.raises(UniconError, match="nothing for too long"):
        fetch(cube(), mirror=server.url, silence=0.2)
    server.piece, server.pace = 1 << 16, 0.0
    fetch(cube(), mirror=server.url)
    assert everything(cache) == WHOLE


@pytest.mark.parametrize("change", ["longer", "shorter", "another"])
def test_a_file_that_is_another_one_is_not_kept(cache: Path, server: Server, change: str) -> None:
    path = server.folder / "cube" / "meshes" / "cube.stl"
    right = path.read_bytes()
    wrong = {"longer": right + b"x", "shorter": right[:-1], "another": b"y" * len(right)}
    path.write_bytes(wrong[change])
    with pytest.raises(UniconError, match=r"asset cube: meshes/cube\.stl"):
        fetch(cube(), mirror=server.url)
    assert not (cache / "models").exists()
    path.write_bytes(right)
    fetch(cube(), mirror=server.url)
    assert everything(cache) == WHOLE


def test_a_file_that_is_absent_is_named_with_the_address(cache: Path, server: Server) -> None:
    (server.folder / "cube" / "cube.xml").unlink()
    with pytest.raises(UniconError, match=rf"{server.url}/cube/cube\.xml: 404.*another --from"):
        fetch(cube(), mirror=server.url)
    assert len([path for path, _ in server.asked if path.endswith("cube.xml")]) == 1
    with pytest.raises(UniconError, match=r"cube\.xml: No such file"):
        fetch(cube(), mirror=server.folder)


def test_a_damaged_file_is_found_and_it_alone_is_fetched_again(
    cache: Path, server: Server, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = fetch(cube(), mirror=server.url).folder
    (folder / "cube.xml").write_bytes(b"<mujocO/>")
    assert wrong_files(folder, cube()) == {"cube.xml": "another SHA-256"}
    assert main(["assets", "verify"]) == 1
    assert "cube.xml: another SHA-256" in capsys.readouterr().out
    assert fetch(cube(), mirror=server.url).fetched == len(FILES["cube.xml"])
    assert main(["assets", "verify", "cube"]) == 0
    assert everything(cache) == WHOLE


FETCH = "import sys; from unicon_ros.cli.main import main; sys.exit(main(sys.argv[1:]))"


def started(*arguments: str, limit: int = 0) -> subprocess.Popen[str]:
    def prepare() -> None:
        if limit:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.Popen(
        [sys.executable, "-c", FETCH, "assets", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=prepare,
    )


def test_a_process_that_is_killed_leaves_nothing_half_made(cache: Path, server: Server) -> None:
    server.pace = 0.1
    process = started("fetch", "cube", "--from", server.url)
    part = cache / ".fetch" / "cube" / "meshes" / "cube.stl.part"
    end = time.monotonic() + 30.0
    while not (part.exists() and part.stat().st_size) and time.monotonic() < end:
        time.sleep(0.005)
    process.kill()
    process.communicate()
    assert not (cache / "models").exists()
    server.pace = 0.0
    assert fetch(cube(), mirror=server.url).fetched < cube().size
    assert everything(cache) == WHOLE


def test_a_full_disk_is_named_and_leaves_nothing_half_made(cache: Path, server: Server) -> None:
    process = started("fetch", "cube", "--from", server.url, limit=100_000)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == 1
    assert "cannot write" in said
    assert "it goes on where it ended" in said
    assert "Traceback" not in said
    assert not (cache / "models").exists()
    fetch(cube(), mirror=server.url)
    assert everything(cache) == WHOLE


def test_what_the_disk_cannot_hold_is_not_begun(
    cache: Path, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = SimpleNamespace(free=100_000)
    monkeypatch.setattr("unicon_core.assets.fetching.shutil.disk_usage", lambda _: full)
    with pytest.raises(UniconError, match=r"needs 0\.5 MB more.*0\.1 MB free"):
        fetch(cube(), mirror=server.url)
    assert not server.asked


def test_of_two_at_once_one_fetches_and_the_other_waits(cache: Path, server: Server) -> None:
    server.pace = 0.05
    two = [started("fetch", "cube", "--from", server.url) for _ in range(2)]
    said = [process.communicate(timeout=60.0) for process in two]
    assert [process.returncode for process in two] == [0, 0], said
    assert everything(cache) == WHOLE
    assert len(server.asked) == len(FILES)
    assert sorted("is there" in out for out, _ in said) == [False, True]


@pytest.mark.parametrize(
    "name", ["../cube.xml", "/etc/passwd", "a/../../b", "a\\b", "a//b", "./a", "", "a\0b"]
)
def test_a_name_that_leads_out_of_the_folder_is_refused(
    cache: Path, tmp_path: Path, name: str
) -> None:
    write_list(tmp_path / "config", {"cube": listed({name: b"x"})})
    with pytest.raises(UniconError, match=r"paths without|control character"):
        load_assets()
    write_list(tmp_path / "config", {f"x/{name}": listed(FILES)})
    with pytest.raises(UniconError, match=r"paths without|control character"):
        load_assets()


def test_a_link_of_the_user_in_the_cache_is_left_alone(
    cache: Path, server: Server, tmp_path: Path
) -> None:
    (cache / "models").mkdir(parents=True)
    (cache / "models" / "cube").symlink_to(tmp_path / "mirror")
    with pytest.raises(UniconError, match="is a link, which is yours"):
        fetch(cube(), mirror=server.url)
    assert not server.asked


def test_unknown_names_and_mirrors_are_one_line(
    cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["assets", "fetch", "cubes"]) == 1
    assert "unknown asset 'cubes'" in capsys.readouterr().err
    assert main(["assets", "fetch", "cube", "--from", "/nowhere"]) == 1
    assert "--from /nowhere: no such folder" in capsys.readouterr().err
    assert main(["assets", "path", "cube"]) == 1
    assert "get it: unicon assets fetch cube" in capsys.readouterr().err


def test_the_licence_is_said_before_the_first_byte(
    cache: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "mirror" / "other" / "LICENSES" / "owner.txt").unlink()
    assert main(["assets", "fetch", "other", "--from", str(tmp_path / "mirror")]) == 1
    out = capsys.readouterr().out
    assert "licence GPL-3.0-only, in its folder LICENSES; who passes it on has duties" in out
    assert "owner/cubes@01234567" in out


def test_the_list_says_what_is_at_hand(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fetch(cube(), mirror=cache.parents[2] / "mirror")
    assert main(["assets", "list", "--json"]) == 0
    told = {each["name"]: each for each in json.loads(capsys.readouterr().out)}
    assert told["cube"]["folder"] == str(cache / "models" / "cube")
    assert told["other"]["folder"] is None
    assert told["other"]["licence"] == "GPL-3.0-only"
    assert main(["assets", "path", "cube"]) == 0
    assert capsys.readouterr().out.strip() == str(cache / "models" / "cube")


def test_addresses_are_those_of_a_commit() -> None:
    for each in named([*load_assets()], load_assets()):
        for file in each.files:
            assert file.source.url(file.path).startswith("https://raw.githubusercontent.com/")
            assert len(file.source.commit) == 40
        names = [file.name for file in each.files]
        assert names == sorted(names, key=lambda name: not name.startswith("LICENSES/"))
        assert each.licence
