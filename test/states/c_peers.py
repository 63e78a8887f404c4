"""Programs in C for the tests, built by this machine's compiler against a header of ours."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from unicon_core.states.c_header import write_header
from unicon_core.states.groups import Groups

ROOT = Path(__file__).resolve().parents[2]
IDENTITY = ROOT / "examples" / "c" / "identity.c"
HAMMER = Path(__file__).with_name("peers") / "hammer.c"
LANGUAGES = {"c99": "cc", "c11": "cc", "c++11": "c++", "c++20": "c++"}
STRICT = ("-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror")


def compile_c(source: Path, folder: Path, standard: str, *options: str) -> str:
    """Run the compiler; return what it says, "" where all is well. Skips where there is none."""
    compiler = shutil.which(LANGUAGES[standard])
    if compiler is None:
        pytest.skip(f"no compiler {LANGUAGES[standard]!r} here")
    language = "c++" if standard.startswith("c++") else "c"
    done = subprocess.run(
        [compiler, *STRICT, f"-std={standard}", f"-I{folder}", *options, "-x", language, source],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return done.stderr if done.returncode else ""


def build(source: Path, groups: Groups, folder: Path, standard: str = "c99") -> Path:
    """Write the header of these groups, build a program with it, and return the program."""
    write_header(folder / "states.h", groups, "a test")
    program = folder / f"{source.stem}_{standard.replace('+', 'p')}"
    assert compile_c(source, folder, standard, "-o", str(program)) == ""
    return program
