"""Text for a terminal: how wide it may be, wrapped lines and short paths, for tables and checks."""

from __future__ import annotations

import re
import shutil
import sys
import unicodedata
from pathlib import Path

WIDTH = 80
"""Columns of what is printed, but to a terminal that is wider."""


def terminal_width() -> int:
    """Return the columns that standard output has: the terminal's where there are more than 80."""
    return max(WIDTH, shutil.get_terminal_size().columns) if sys.stdout.isatty() else WIDTH


def display_width(text: str) -> int:
    """Return the columns that a text takes: wide letters take two, combining marks none."""
    if text.isascii():
        return len(text)
    return sum(
        0
        if unicodedata.category(letter) in ("Mn", "Me", "Cf")
        else 1 + (unicodedata.east_asian_width(letter) in "WF")
        for letter in text
    )


def near(text: str) -> str:
    """Return a text with its paths from the working folder on, or from the home folder as `~`."""
    for folder, short in ((Path.cwd(), ""), (Path.home(), "~/")):
        if folder.name:  # else it is the root
            text = re.sub(rf"(?<![\w./~-]){re.escape(str(folder))}/", short, text)
    return text


def words(text: str) -> list[str]:
    """Return what a line may break between; a range, as `-1 … 1`, stays together."""
    return re.split(r"(?<![\d?] …)\s+(?!… [-\d?])", text.strip())


def word_parts(word: str) -> list[str]:
    """Return what a long word may break between: behind slashes, as of a path, but of no unit."""
    return [word] if re.fullmatch(r"\[[^/]+/[^/]+\]", word) else re.findall(r"[^/]*/|[^/]+", word)


def wrapped(text: str, width: int, first: str = "", then: str = "") -> list[str]:
    """Return a text as lines; a word stands out where it is longer and has no slash to break at.

    Args:
        text: words.
        width: columns that a line may take.
        first: begins the first line.
        then: begins the others.
    """
    lines, line, bare = [], first, True
    for word in words(text):
        whole = display_width(then + word) <= width
        for k, part in enumerate([word] if whole else word_parts(word)):
            gap = "" if bare or k else " "
            if not bare and display_width(line + gap + part) > width:
                lines.append(line)
                line, gap = then, ""
            line, bare = line + gap + part, False
    return [*lines, line]
