"""Libraries of native ticks: compiled once by the system's compiler, and kept in the user's cache.

A library's name in the cache is the hash of its source, compiler, flags and machine. It is written
under a temporary name and renamed, and ends with its own SHA-256, so that a file that is cut off or
foreign is never loaded. What is loaded is a private copy in memory: each program has variables of
its own, and a file that changes under a run changes nothing.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import re
import shlex
import shutil
import subprocess
import time
from _ctypes import dlclose
from contextlib import suppress
from pathlib import Path

from unicon_base.errors import UniconError, one_line
from unicon_base.resources import native_cache

FLAGS = ("-O2", "-std=c++17", "-fno-fast-math", "-ffp-contract=off", "-shared", "-fPIC", "-pipe")
LANGUAGE = ("-x", "c++", "-")
COMPILERS = ("c++", "g++", "clang++")
PATIENCE = 120.0
"""Longest time that a compiler may take, in [s]; a G1's tick takes 2."""
STALE = 3600.0
"""Age of a temporary file whose writer has died, in [s]."""
UNUSED = 30 * 86400.0
"""Age of a library that goes when another one is compiled, since it was used, in [s]."""
MARK = b"\nunicon native "
"""Precedes the hash at the end of a cached library."""


class NativeError(UniconError):
    """The native tick cannot be had: why, and what to do."""


def compiler() -> tuple[list[str], str]:
    """Return the compiler's command, and its macros: they tell its version and the CPU features.

    Raises:
        NativeError: there is none, or it does not run.
    """
    given = os.environ.get("CXX", "").strip()
    names = [given] if given else list(COMPILERS)
    command = next((words for n in names if (words := _words(n)) and shutil.which(words[0])), None)
    if command is None:
        what = (
            f"CXX={given} is no command"
            if given
            else f"none of {', '.join(COMPILERS)} is installed"
        )
        raise NativeError(f"no C++ compiler: {what}; apt install g++, or set CXX")
    return command, _output([*command, *LANGUAGE, "-dM", "-E"])


def load(source: str) -> ctypes.PyDLL:
    """Return the library of a source, from the cache or newly compiled.

    Raises:
        NativeError: it cannot be compiled, kept or loaded; one line with the remedy.
    """
    if not hasattr(os, "memfd_create"):  # as of conda
        raise NativeError("it needs Linux and a Python with os.memfd_create; leave out --native")
    command, about = compiler()
    parts = [source, about, *command, *FLAGS, *platform.libc_ver()]
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    folder = native_cache()
    if folder is None:
        raise NativeError("there is no home folder for the library; set XDG_CACHE_HOME")
    path = folder / f"{key}.so"
    try:
        with suppress(ValueError, OSError):
            return _opened_library(_content(path), key)
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _sweep(folder)
        _compile(command, source, key, path)
        return _opened_library(_content(path), key)
    except ValueError as error:
        raise NativeError(f"the new library {path} is unusable: {error}; remove it") from error
    except OSError as error:
        raise NativeError(
            f"cannot keep a library in {folder}: {error.strerror or one_line(error)}; make room or "
            "give write access there, or set XDG_CACHE_HOME"
        ) from error


def _words(text: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError:
        return []


def _output(command: list[str], text: str = "") -> str:
    """Run a compiler and return what it prints.

    Raises:
        NativeError: it fails, with its first error.
    """
    environment = {**os.environ, "LC_ALL": "C"}
    try:
        done = subprocess.run(
            command, input=text, capture_output=True, text=True, errors="replace",
            timeout=PATIENCE, env=environment, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise NativeError(
            f"{command[0]} took more than {PATIENCE:g} s; set CXX to another"
        ) from None
    except OSError as error:
        raise NativeError(
            f"{command[0]} does not run: {error.strerror}; set CXX to another"
        ) from error
    if done.returncode:
        lines = [*filter(str.strip, done.stderr.splitlines()), "no message"]
        said = next((line for line in lines if re.search("error|failed", line)), lines[0])
        raise NativeError(
            f"{command[0]} fails with status {done.returncode}: {said.strip()[:200]}; set CXX to "
            "another compiler"
        )
    return done.stdout


def _compile(command: list[str], source: str, key: str, path: Path) -> None:
    """Compile into the cache, all or nothing; two at once do not disturb each other."""
    symbol = (
        f'\nextern "C" {{ extern const char unicon_key[]; const char unicon_key[] = "{key}"; }}\n'
    )
    part = path.with_name(f".{key}.{os.getpid()}.{time.monotonic_ns()}.part")
    try:
        _output([*command, *FLAGS, *LANGUAGE, "-o", str(part), "-lm"], source + symbol)
        content = part.read_bytes()
        with part.open("ab") as stream:
            stream.write(MARK + hashlib.sha256(content).hexdigest().encode())
        part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink()


def _content(path: Path) -> bytes:
    """Return a cached library without its mark.

    Raises:
        ValueError: it is cut off, changed, or another user's.
        OSError: it cannot be read.
    """
    with path.open("rb") as stream:
        if os.fstat(stream.fileno()).st_uid not in (0, os.getuid()):
            raise ValueError("it belongs to another user")
        data = stream.read()
    content, _, digest = data.rpartition(MARK)
    if not content or hashlib.sha256(content).hexdigest().encode() != digest:
        raise ValueError("it is cut off or changed")
    return content


def _opened_library(content: bytes, key: str) -> ctypes.PyDLL:
    """Load a private copy of a library, and compare its key.

    Raises:
        ValueError: it cannot be loaded, or is another one.
    """
    file = os.memfd_create("unicon native")
    try:
        with open(file, "wb", closefd=False) as stream:
            stream.write(content)
        # It stays open: the loader would take a path that it knows for the library of before.
        library = ctypes.PyDLL(f"/proc/self/fd/{file}")
        found = (ctypes.c_char * (len(key) + 1)).in_dll(library, "unicon_key").value
    except (OSError, ValueError) as error:
        os.close(file)
        raise ValueError(f"it cannot be loaded: {one_line(error)}") from error
    if found != key.encode():
        raise ValueError("it is of another source")
    return library


def unload(library: ctypes.PyDLL) -> None:
    """Close a library that nothing calls any more."""
    dlclose(library._handle)
    os.close(int(Path(library._name).name))


def _sweep(folder: Path) -> None:
    """Remove temporary files of compilers that were killed, and libraries long unused."""
    for path in folder.iterdir():
        with suppress(OSError):
            found = path.stat()
            age = time.time() - max(found.st_atime, found.st_mtime)
            if age > (STALE if path.suffix == ".part" else UNUSED):
                path.unlink()
