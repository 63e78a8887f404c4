"""Fetches assets into the user's cache: whole or not at all, and goes on where it was cut off.

A file arrives as `.part` in a folder beside the cache's own (`.fetch/NAME`), which becomes
`models/NAME` or `policies/NAME` by one rename once each file has its size and SHA-256. One process
at a time fetches an asset; others wait for it.
"""

from __future__ import annotations

import fcntl
import http.client
import io
import os
import shutil
import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, urlsplit

from unicon_base import UniconError
from unicon_base.resources import CHUNK, assets_cache, sha256_of
from unicon_core.assets.manifest import Asset, AssetFile, wrong_files

SILENCE = 30.0
"""In [s]: a server that sends nothing for so long is given up."""
LEAST = 4096
"""Bytes that have to come in that time."""
STAGING = ".fetch"
"""Folder of the cache in which files arrive."""
ATTEMPTS = 2
"""Of a file whose connection breaks; each goes on where the one before ended."""
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Got:
    """An asset that is at hand.

    Attributes:
        asset: which.
        folder: where.
        fetched: bytes that came over the network, 0 where all was there.
    """

    asset: Asset
    folder: Path
    fetched: int


def fetch(
    asset: Asset,
    *,
    mirror: str | Path | None = None,
    progress: Progress | None = None,
    waits: Callable[[], None] | None = None,
    silence: float = SILENCE,
) -> Got:
    """Fetch an asset into the cache, if it is not there.

    Args:
        asset: which.
        mirror: folder or http(s) address that has `NAME/FILE`, instead of GitHub.
        progress: is called with the file's name, its bytes so far and all that it has.
        waits: is called once where another process is fetching it.
        silence: after so long without a byte, in [s], a server is given up.

    Raises:
        UniconError: it cannot be had, a file is another one than the list says, or the cache cannot
            be written. What has come so far stays for the next try, but for wrong files.
    """
    root = assets_cache()
    if root is None:
        raise UniconError("assets fetch: there is no home folder; set XDG_CACHE_HOME or HOME")
    folder, staging = root / asset.folder, root / STAGING / asset.name
    with _written(root), _alone(staging, waits):
        if os.path.islink(folder):
            raise UniconError(f"{folder} is a link, which is yours; remove it, then fetch again")
        wrong = wrong_files(folder, asset)
        if not wrong:
            return Got(asset, folder, 0)
        _room(root, asset, staging)
        get = _opener(mirror, silence)
        came = 0
        staged = wrong_files(staging, asset)
        for file in asset.files:
            place = staging / file.name
            if file.name in staged:
                place.parent.mkdir(parents=True, exist_ok=True)
                place.unlink(missing_ok=True)
                if file.name in wrong:
                    came += _file(asset, file, place, get, progress, silence)
                else:
                    shutil.copyfile(folder / file.name, place)
        _put(staging, folder, {file.name for file in asset.files})
    return Got(asset, folder, came)


def _put(staging: Path, folder: Path, names: set[str]) -> None:
    """Let a staging folder, with these files alone, be the asset's; what was there is removed."""
    for path in staging.rglob("*"):
        if path.is_file() and path.relative_to(staging).as_posix() not in names:
            path.unlink()  # of an earlier list
    old = staging.with_name(f"{staging.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    if folder.exists():
        folder.rename(old)
    staging.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def _room(root: Path, asset: Asset, staging: Path) -> None:
    """Refuse to begin what the disk cannot hold."""
    there = sum(path.stat().st_size for path in staging.rglob("*") if path.is_file())
    free, needed = shutil.disk_usage(root).free, asset.size - there
    if needed > free:
        raise UniconError(
            f"asset {asset.name} needs {needed / 1e6:.1f} MB more, and {root} has "
            f"{free / 1e6:.1f} MB free; make room there, or set XDG_CACHE_HOME"
        )


@contextmanager
def _written(root: Path) -> Iterator[None]:
    """Turn what the file system refuses into one line; each file that came is kept."""
    try:
        root.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise UniconError(
            f"cannot write {error.filename or root}: {error.strerror or error}; make room or give "
            "write access, or set XDG_CACHE_HOME; then fetch again: it goes on where it ended"
        ) from error


@contextmanager
def _alone(staging: Path, waits: Callable[[], None] | None) -> Iterator[None]:
    """Keep other processes out; the lock ends with the process that has it."""
    staging.parent.mkdir(parents=True, exist_ok=True)
    with staging.with_name(f"{staging.name}.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if waits is not None:
                waits()
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


# -- one file -----------------------------------------------------------------------------------


# Opens a file behind so many bytes; returns it and where it really begins.
_Opener = Callable[[Asset, AssetFile, int], tuple[io.BufferedIOBase, int]]


def _file(
    asset: Asset,
    file: AssetFile,
    place: Path,
    get: _Opener,
    progress: Progress | None,
    silence: float,
) -> int:
    """Fetch a file to its place; return how many bytes came."""
    part = place.with_name(f"{place.name}.part")
    before = part.stat().st_size if part.is_file() else 0
    for attempt in range(ATTEMPTS):
        try:
            _rest(asset, file, part, get, progress, silence)
            break
        except _Broken as broken:
            if attempt == ATTEMPTS - 1 or not broken.again:
                raise UniconError(f"asset {asset.name}: {broken}") from broken
    if sha256_of(part) != file.sha256:
        part.unlink()
        raise UniconError(
            f"asset {asset.name}: {file.name} has another SHA-256 than config/assets.yaml says "
            f"({file.sha256[:12]}…); it was removed: try again, or another --from"
        )
    part.rename(place)
    return file.size - min(before, file.size)


class _Broken(Exception):
    """A connection that broke; `again` where another try may do better."""

    def __init__(self, text: str, again: bool = True) -> None:
        super().__init__(text)
        self.again = again


def _rest(
    asset: Asset,
    file: AssetFile,
    part: Path,
    get: _Opener,
    progress: Progress | None,
    silence: float,
) -> None:
    """Let a file have all its bytes.

    Raises:
        _Broken: the server, or the connection, gave out.
    """
    done = part.stat().st_size if part.is_file() else 0
    if done > file.size:
        part.unlink()
        done = 0
    if done == file.size and part.is_file():
        return
    source, done = get(asset, file, done)
    with closing(source), part.open("r+b" if done else "wb") as out:
        out.truncate(done)
        out.seek(done)
        begun, before = time.monotonic(), done
        while True:
            if time.monotonic() > begun + silence:
                if done - before < LEAST:
                    raise _Broken(_why(file, TimeoutError()))
                begun, before = time.monotonic(), done
            try:
                chunk = source.read1(min(CHUNK, file.size - done + 1))
            except (OSError, http.client.HTTPException) as error:
                raise _Broken(_why(file, error)) from error
            if not chunk:
                break
            done += len(chunk)
            if done > file.size:
                break
            out.write(chunk)
            if progress is not None:
                progress(file.name, done, file.size)
    if done != file.size:
        much = "more" if done > file.size else f"{done}"
        raise _Broken(f"{file.name}: {much} bytes came, not {file.size}", again=done < file.size)


def _opener(mirror: str | Path | None, silence: float) -> _Opener:
    text = str(mirror or "")
    if mirror is None or text.startswith(("http://", "https://")):
        return _Web(text.rstrip("/"), silence)
    folder = Path(text).expanduser()
    if not folder.is_dir():
        raise UniconError(f"--from {text}: no such folder; give one, or an http(s) address")

    def open_file(asset: Asset, file: AssetFile, begin: int) -> tuple[io.BufferedIOBase, int]:
        path = folder / asset.name / file.mirrored
        try:
            found = path.open("rb")
        except OSError as error:
            raise _Broken(f"{path}: {error.strerror}", again=False) from error
        found.seek(begin)
        return found, begin

    return open_file


class _Web:
    """Opens files of GitHub, or of a mirror, by HTTP."""

    def __init__(self, mirror: str, silence: float) -> None:
        self._mirror, self._silence = mirror, silence
        self._context = ssl.create_default_context()  # the system's certificates

    def __call__(self, asset: Asset, file: AssetFile, begin: int) -> tuple[io.BufferedIOBase, int]:
        """Open a file; one that the server only sends whole begins at 0."""
        url = file.source.url(file.path)
        if self._mirror:
            url = f"{self._mirror}/{quote(f'{asset.name}/{file.mirrored}', safe='/')}"
        asked = urllib.request.Request(url, headers={"User-Agent": "unicon"})
        if begin:
            asked.add_header("Range", f"bytes={begin}-")
        try:
            answer = urllib.request.urlopen(asked, timeout=self._silence, context=self._context)
        except urllib.error.HTTPError as error:
            with error:
                told = f"{url}: {error.code} {error.reason}; try another --from"
                raise _Broken(told, again=error.code >= 500) from error
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise _Broken(_why(file, error, urlsplit(url).netloc)) from error
        told = answer.headers.get("Content-Range", "")
        partial = answer.status == 206 and told.startswith(f"bytes {begin}-")
        return answer, begin if partial else 0


def _why(file: AssetFile, error: Exception, server: str = "the server") -> str:
    reason = getattr(error, "reason", error)
    if isinstance(reason, TimeoutError):
        reason = "it sent little or nothing for too long"
    return (
        f"{file.name}: {server}: {reason}; fetch again: it goes on where it ended, or give --from "
        "DIR or URL of a mirror"
    )
