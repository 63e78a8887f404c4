"""Runs cases of one kind in a process of its own: bounded in time and memory, and watched.

`python worker.py KIND SEED FIRST COUNT OUT` writes a line of JSON to OUT before each case and for
each finding, so that who started it knows the case of a crash. A case depends on KIND, SEED and its
number alone: `python worker.py workflow 7 1234 1 /dev/stdout` runs that one and prints its file.
Without arguments it forks for each line of JSON that it is given: see `serve`.
"""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import Any

HANG_S = 5.0
MEMORY = 6 << 30

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.pop("UNICON_ASSETS", None)


class Hang(BaseException):
    """A case took too long; no `except Exception` may swallow it."""


class Watch:
    """An audit hook that notes what only somebody would do whom a file has told to."""

    PROCESS = (
        "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.forkpty",
        "os.startfile", "subprocess.Popen", "pty.spawn", "socket.connect", "socket.bind",
        "socket.getaddrinfo",        "ctypes.dlopen", "webbrowser.open", "urllib.Request",
    )  # fmt: skip
    CHANGES = (
        "os.remove",
        "os.rename",
        "os.rmdir",
        "os.mkdir",
        "os.chmod",
        "os.symlink",
        "os.link",
    )
    # Who may run code objects: imports, and what makes classes of our own or of a .msg file.
    RUNNERS = (
        "importlib", "frozen", "dataclasses", "collections", "typing", "rosbags", "generated.py",
        "typesys", "serde", "unicon_base/generated",
    )  # fmt: skip

    def __init__(self) -> None:
        self.folder = ""
        self.on = False
        self.seen: list[str] = []

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event in self.PROCESS or (event in self.CHANGES and not self.ours(arguments[0])):
            self.note(event, arguments)
        elif event == "open":
            path, mode, flags = arguments
            writes = any(c in mode for c in "wax+") if mode else flags & (os.O_WRONLY | os.O_RDWR)
            if writes and not self.ours(path):
                self.note(event, arguments)
        elif event == "exec":
            caller = sys._getframe(1).f_code.co_filename
            if not any(word in caller for word in self.RUNNERS):
                self.note(event, (arguments[0].co_filename, caller))

    def ours(self, path: Any) -> bool:
        try:
            # A recording is recovered beside itself, by names in its folder; a half file hides.
            return os.fspath(path).startswith((self.folder, "fuzzed.", ".fuzzed."))
        except TypeError:
            return isinstance(path, int)

    def note(self, event: str, arguments: tuple[Any, ...]) -> None:
        self.seen.append(f"{event} {arguments!r}"[:300])


def main(kind: str, seed: int, first: int, count: int, out: str) -> None:
    # The fuzz's own imports happen before anything is watched.
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    sys.dont_write_bytecode = True
    warnings.simplefilter("ignore")
    from kinds import KINDS
    from mutate import SENTINEL

    from unicon_base.errors import UniconError

    make = KINDS[kind]
    watch = Watch()
    sys.addaudithook(watch)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))

    def on_alarm(number: int, frame: object) -> None:
        raise Hang

    signal.signal(signal.SIGPROF, on_alarm)
    home = Path(tempfile.mkdtemp(prefix="unicon_fuzz_"))
    os.chdir(home)
    watch.folder = str(home)
    with open(out, "a", encoding="utf-8") as log:

        def tell(**values: Any) -> None:
            log.write(json.dumps(values) + "\n")
            log.flush()

        for number in range(first, first + count):
            tell(case=number)
            folder = home / "case"
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            dice = random.Random(f"{kind} {seed} {number}")
            sys.setrecursionlimit(20000)  # of the dump of a deep tree, not of who reads it
            read = make(dice, folder)
            sys.setrecursionlimit(1000)
            watch.seen.clear()
            verdict, detail = "accepted", ""
            signal.setitimer(signal.ITIMER_PROF, HANG_S)
            watch.on = True
            try:
                read()
            except UniconError as error:
                verdict = "refused"
                each = error.problems or (error,)
                if any("\n" in str(one).strip() for one in each):
                    verdict, detail = "several lines", str(error)
            except Hang:
                verdict, detail = "hang", traceback.format_exc()
            except BaseException:
                verdict, detail = "traceback", traceback.format_exc()
            finally:
                watch.on = False
                signal.setitimer(signal.ITIMER_PROF, 0.0)
            if (home / SENTINEL).exists() or (folder / SENTINEL).exists() or watch.seen:
                verdict, detail = "execution", "\n".join(watch.seen) or "the sentinel was written"
            tell(done=number, verdict=verdict, detail=detail[-6000:], files=shown(folder, verdict))
    shutil.rmtree(home, ignore_errors=True)


def serve() -> None:
    """Run what lines of JSON ask for: the arguments of `main`, and a file for what is spoken.

    Each in a fork, which has this process' imports: they take longer than the cases of a quick run.
    Answers with its process id, and with its exit status when it has ended.
    """
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    import kinds  # noqa: F401

    for line in sys.stdin:
        *arguments, spoken = json.loads(line)
        process = os.fork()
        if process == 0:
            os.chdir(Path(spoken).parent)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(os.open(spoken, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
            os.dup2(1, 2)
            main(*arguments)
            return
        print(process, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)


def shown(folder: Path, verdict: str) -> dict[str, str]:
    """Return the text of the files of a case that failed."""
    if verdict in ("accepted", "refused"):
        return {}
    return {
        str(path.relative_to(folder)): path.read_bytes()[:4000].decode("utf-8", "backslashreplace")
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix != ".onnx"
    }


if __name__ == "__main__":
    if len(sys.argv) == 1:
        serve()
        sys.exit()
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), sys.argv[5])
