"""Text tables: rows of cells as aligned lines, for whatever is shown in a terminal."""

from __future__ import annotations

from collections.abc import Container, Sequence

__all__ = ["aligned"]


def aligned(
    rows: Sequence[Sequence[str]], *, right: Container[int] = (), underlined: bool = True
) -> list[str]:
    """Return rows of cells as lines.

    Args:
        rows: of equal length, the first one the heads.
        right: columns that are aligned to the right.
        underlined: whether a rule stands below the heads.
    """
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = [
        "  ".join(
            cell.rjust(width) if column in right else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths))
        ).rstrip()
        for row in rows
    ]
    if underlined:
        lines.insert(1, "  ".join("─" * width for width in widths))
    return lines
