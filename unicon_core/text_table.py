"""Text tables: rows of cells as aligned lines, for whatever is shown in a terminal."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from itertools import zip_longest

from unicon_core.terminal import display_width, word_parts, words, wrapped

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
        width: columns of the display that a line may take; None for any number. Two columns of
            long words that have no slash to break at take more.
    """
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
