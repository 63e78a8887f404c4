"""`unicon`: parses the command line and runs one command.

Exit status: 0 done, 1 bad input, 2 usage, 3 fault. Nothing heavy is imported before a command needs
it: `unicon --help` loads neither rclpy, MuJoCo nor onnxruntime.
"""

from __future__ import annotations

import argparse
import atexit
import errno
import gc
import logging
import os
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import unicon_core
from unicon_base import UniconError, one_line
from unicon_base.packages import loaded
from unicon_core.non_blocking_writer import open_standard_files
from unicon_core.signals import SIGNALS, Interrupted
from unicon_core.text_table import alarming
from unicon_ros.cli import assets, bench, check, doctor, known, preflight, run, states, talk

OURS = {
    "run": run.add,
    "check": check.add,
    "preflight": preflight.add,
    "schema": check.add_schema,
    "show": check.add_show,
    "export": check.add_export,
    "states": states.add,
    "bench": bench.add,
    "known": known.add,
    "assets": assets.add,
    "latches": doctor.add_latches,
    "doctor": doctor.add,
    "talk": talk.add,
}
ORDER = (
    *("run", "check", "preflight", "serve", "emulate", "schema", "show", "export", "states", "bag"),
    *("replay", "diagnose", "analyze", "transfer", "sweep", "view", "bench", "known", "assets"),
    *("latches", "doctor", "talk", "report_run"),
)
"""Commands as their list has them; those of other packages come behind."""


class _Parser(argparse.ArgumentParser):
    """A parser with what stands before a command and behind it."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        for short, word, what in (
            ("-q", "--quiet", "less: no status line; of lists the names"),
            (
                "-v",
                "--verbose",
                "more: the blocks' times, what the parts log, and where an error comes from",
            ),
        ):
            told = argparse.SUPPRESS  # what was said before the command stays
            self.add_argument(short, word, action="store_true", default=told, help=what)


def _parser(command: str = "") -> argparse.ArgumentParser:
    """Return the parser of all commands; of one of ours alone where it is named, which saves 20 ms.

    Args:
        command: the first word of the command line.
    """
    parser = _Parser(
        prog="unicon",
        description="Run learned robot controllers on simulators and robots, mirrored to ROS 2.",
    )
    parser.set_defaults(quiet=False, verbose=False)
    parser.add_argument("--version", action="version", version=unicon_core.__version__)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    if command in OURS:
        OURS[command](commands)
        return parser
    adders = {name: each.add for name, each in loaded("commands").items()} | OURS
    for name in dict.fromkeys((*ORDER, *adders)):
        if name in adders:
            adders[name](commands)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    Args:
        argv: arguments without the program's name; those of the process if None.
    """
    atexit.register(gc.freeze)  # the last collection frees what the kernel frees anyway: 80 ms
    open_standard_files()
    with SIGNALS:  # before anything is imported or opened
        status = _run(argv)
        return _finish(status)


def _run(argv: Sequence[str] | None) -> int:
    words = [*(sys.argv[1:] if argv is None else argv)]
    if " ".join(words[:2]) in known.VERBS:
        words[:2] = [" ".join(words[:2])]
    completes = "_ARGCOMPLETE" in os.environ
    parser = _parser("" if completes else " ".join(words[:1]))
    if completes:
        known.complete(parser)
    arguments = parser.parse_args(words)
    if arguments.verbose:
        logging.basicConfig(level=logging.INFO, format="unicon: %(name)s: %(message)s")
        os.environ["UNICON_TRACEBACK"] = "1"
    try:
        return int(arguments.function(arguments))
    except UniconError as error:
        return _refuse(str(error))
    except Interrupted as interrupted:
        return 128 + interrupted.number
    except BrokenPipeError:
        return 0  # the reader has gone (`unicon show … | head`): nobody is left to tell
    except OSError as error:
        if error.filename is None and error.errno == errno.ENOSPC:
            return _refuse(f"cannot write: {error.strerror}; make room where the output goes")
        if error.errno == errno.EMFILE:
            from unicon_core.runtime.report import out_of_files

            return _refuse(f"{error.strerror}{out_of_files(error)}")
        return _unforeseen(error)
    except Exception as error:
        return _unforeseen(error)


def _refuse(message: str) -> int:
    with suppress(OSError):
        print(f"{alarming('unicon: error:', sys.stderr)} {message}", file=sys.stderr)
    return 1


def _unforeseen(error: Exception) -> int:
    """Tell an error that nobody foresaw in one line; all of it where it is asked for."""
    if os.environ.get("UNICON_TRACEBACK"):
        raise error
    last = traceback.extract_tb(error.__traceback__)[-1]
    text = one_line(error)[:500]
    return _refuse(
        f"{type(error).__name__}: {text} ({os.path.basename(last.filename)}:{last.lineno}); "
        "this was not foreseen: --verbose shows where it comes from; report it"
    )


def _finish(status: int) -> int:
    """Flush what was printed; output that does not arrive makes no failed run a good one."""
    try:
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        pass
    except OSError as error:
        status = status or _refuse(f"cannot write to standard output: {error.strerror}")
    with suppress(OSError, ValueError):  # Python flushes once more at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return status
