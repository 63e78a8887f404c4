"""Text for a terminal: numbers, wrapped lines, short paths, and rows of cells as aligned lines."""

from __future__ import annotations

import os
import re
import shutil
import sys
import unicodedata
from collections.abc import Collection, Iterable, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TextIO

WIDTH = 80
"""Columns of what is printed, but to a terminal that is wider."""


def terminal_width() -> int:
    """Return the columns that standard output has: the terminal's where there are more than 80."""
    return max(WIDTH, shutil.get_terminal_size().columns) if sys.stdout.isatty() else WIDTH


def fitted(text: str) -> str:
    """Return a text whose lines fit the terminal; as it is where standard output is none.

    What stands behind a label, or the branch of a tree, and two blanks stays in its column.
    """
    if not sys.stdout.isatty():
        return text
    lines, width = [], terminal_width()
    for line in text.split("\n"):
        first = re.match(r"\s*(?:\S.*?\s{2,}(?=\w))?", line)[0]  # type: ignore[index]
        short = display_width(line) <= width
        lines += [line] if short else wrapped(line[len(first) :], width, first, " " * len(first))
    return "\n".join(lines)


def alarming(text: str, stream: TextIO) -> str:
    """Return a text in red where a stream is a terminal with colours, else as it is."""
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return text if plain or not stream.isatty() else f"\x1b[31m{text}\x1b[0m"


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


Rows = Sequence[Sequence[str]]


def aligned(
    rows: Rows, *, right: Collection[int] = (), underlined: bool = True, width: int | None = None
) -> list[str]:
    """Return rows of cells as lines.

    What is wider than it may be gets heads of several lines, then narrow gaps and ranges, then
    cells of several lines, and at last becomes two tables that both begin with the first column.

    Args:
        rows: of equal length, the first one the heads.
        right: columns that are aligned to the right.
        underlined: whether a rule stands below the heads.
        width: columns of the display that a line may take; None for those of the terminal, or
            any number where standard output is none. Two columns of long words that have no slash
            to break at take more.
    """
    if width is None and sys.stdout.isatty():
        width = terminal_width()
    lines = _fitted(rows, right, underlined, width)
    if lines is not None:
        return lines
    count = len(rows[0])
    if count < 3:
        return _lines(rows, _least(rows), 1, right, underlined)
    sizes = [max(map(display_width, column)) for column in zip(*rows)]
    k = min(range(2, count), key=lambda k: max(sum(sizes[:k]), sizes[0] + sum(sizes[k:])))
    tables = [
        aligned(
            [[row[i] for i in part] for row in rows],
            right=[at for at, i in enumerate(part) if i in right],
            underlined=underlined,
            width=width,
        )
        for part in (range(k), (0, *range(k, count)))
    ]
    return [*tables[0], "", *tables[1]]


def _fitted(
    rows: Rows, right: Collection[int], underlined: bool, width: int | None
) -> list[str] | None:
    """Return the lines of one table, or None where there is none of that width."""
    natural = [max(map(display_width, column)) for column in zip(*rows)]
    if width is None:
        return _lines(rows, natural, 2, right, underlined)
    closed = [[re.sub(r"(?<=[\d?]) … (?=[-\d?])", "…", cell) for cell in row] for row in rows]
    for whole in (True, False):  # whether only heads take several lines
        for gap, cells in ((2, rows), (1, closed)):
            widths = _narrowed(cells, width, gap, whole)
            if widths is not None:
                return _lines(cells, widths, gap, right, underlined)
    return None


def _narrowed(rows: Rows, width: int, gap: int, whole: bool) -> list[int] | None:
    """Return the widths of columns, the less of their cells take several lines the better."""
    sizes = [[display_width(cell) for cell in column] for column in zip(*rows)]
    widths, least = [max(column) for column in sizes], _least(rows)
    if whole:
        least = [max(each, *column[1:], 0) for each, column in zip(least, sizes)]
    while sum(widths) + gap * (sum(map(bool, widths)) - 1) > width:
        able = [i for i, each in enumerate(widths) if each > least[i]]
        if not able:
            return None
        broken = {i: sum(size >= widths[i] for size in sizes[i]) for i in able}
        widths[min(able, key=lambda i: (broken[i], -widths[i]))] -= 1
    return widths


def _least(rows: Rows) -> list[int]:
    """Return the longest part of a word in each column."""
    return [
        max(display_width(p) for cell in column for w in words(cell) for p in word_parts(w) or [""])
        for column in zip(*rows)
    ]


def _lines(
    rows: Rows, widths: Sequence[int], gap: int, right: Collection[int], underlined: bool
) -> list[str]:
    lines: list[str] = []
    for row in rows:
        cells = [
            [cell] if display_width(cell) <= width else wrapped(cell, width)
            for cell, width in zip(row, widths)
        ]
        for parts in zip_longest(*cells, fillvalue=""):
            line = ""
            for column, (part, width) in enumerate(zip(parts, widths)):
                blank = " " * (width - display_width(part))
                line += (blank + part if column in right else part + blank) + " " * gap
            lines.append(line.rstrip())
        if underlined and row is rows[0]:
            lines.append((" " * gap).join("─" * width for width in widths).rstrip())
    return lines


def number_text(value: float) -> str:
    """Return a number as tables show it: whole ones in full, others to 4 digits."""
    return str(value) if isinstance(value, int) else f"{value:.4g}"


def figure(value: float, form: str = "g") -> str:
    """Return a number as text: `?` for one that is not known, and no zero with a minus sign."""
    if value != value:
        return "?"
    text = format(float(value), form)
    return text if text.strip("+-0.%") else format(abs(float(value)), form)


def span(low: float, high: float, dots: str = " … ", form: str = "g") -> str:
    """Return a range as text: as `figure`, with something between its ends."""
    return f"{figure(low, form)}{dots}{figure(high, form)}"


def figures(values: Iterable[float], form: str = "g") -> list[str]:
    """Return figures one by one; see `figure`."""
    return [figure(value, form) for value in values]


def spans(low: Iterable[float], high: Iterable[float], form: str = "g") -> list[str]:
    """Return spans one by one; see `span`."""
    return [span(*ends, form=form) for ends in zip(low, high)]
