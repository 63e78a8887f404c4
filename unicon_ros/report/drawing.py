"""Drawings by matplotlib, for pages and as PNGs; they take the colours of a page, light or dark."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import MissingDependencyError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, MARK, PALE = "#222221", "#1f4e9c", "#b8b8b8"
"""Text and axes, what is looked at first, what stands behind it. The first two follow the page."""
_PAPER = "#fefefd"
POINTS = 1500
"""Of a curve: of more than twice as many the lowest and the highest of each stretch are drawn."""

_FOLLOWS = {INK: "currentColor", MARK: "var(--mark)", _PAPER: "var(--page)"}
_LOOKS: dict[str, Any] = {
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor"), INK),
    **dict.fromkeys(("xtick.color", "ytick.color", "axes.titlecolor"), INK),
    **dict.fromkeys(("figure.facecolor", "axes.facecolor"), "none"),
    "legend.facecolor": _PAPER,
    "grid.color": "0.5",
    "svg.fonttype": "none",  # text stays text
    "path.simplify_threshold": 0.2,  # pixels; an eye sees no more
}


def require(what: str) -> None:
    """Say before the work that it cannot be drawn.

    Args:
        what: that draws, such as `--picture`.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            what, "matplotlib", "pip install 'unicon_ros[plots]'"
        ) from error


def drawn(fill: Callable[..., bool], *of: Any) -> Figure | None:
    """Return a figure, or None where there is nothing to show in it.

    Args:
        fill: gets the figure, then `of`; whether it has drawn anything.
        of: what is drawn.
    """
    from matplotlib import style
    from matplotlib.figure import Figure

    with style.context(["default", _LOOKS]):
        figure = Figure(dpi=110, layout="constrained")
        return figure if fill(figure, *of) else None


def as_png(figure: Figure) -> bytes:
    """Return a figure as PNG, on white."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", facecolor="white")
    return stream.getvalue()


def as_svg(figure: Figure, name: str) -> str:
    """Return a figure as an `<svg>` element of a page.

    Args:
        figure: of `drawn`.
        name: of it on the page: the names of its parts begin with it, so that no two clash.
    """
    from matplotlib import style

    stream = io.StringIO()
    with style.context(["default", _LOOKS, {"svg.hashsalt": name}]):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r"url\(#", f"url(#{name}-", text)
    text = text.replace("xlink:href=", "href=").replace('href="#', f'href="#{name}-')
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text, count=2)  # a page knows them
    text = re.sub(r'\bd="[^"]*"', _short, text)
    text = re.sub(r"<style.*?</style>", "", text, flags=re.DOTALL)  # it would count for the page
    for colour, follows in _FOLLOWS.items():
        text = text.replace(colour, follows)
    return text


def _short(way: re.Match[str]) -> str:
    """Return a way to a hundredth of a point, on one line."""
    return re.sub(r"(\.\d\d)\d+", r"\1", " ".join(way[0].split()))


def envelope(
    time: NDArray[Any], values: NDArray[Any], points: int = POINTS
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return a curve with few enough points that no peak is lost.

    Args:
        time: shape (n,).
        values: shape (n,) or (n, curves).
        points: stretches of which the lowest and the highest value is drawn.
    """
    if len(values) <= 2 * points:
        return time, values
    each = math.ceil(len(values) / points)
    starts = np.arange(0, len(values), each)
    low, high = (f.reduceat(values, starts) for f in (np.minimum, np.maximum))
    return np.repeat(time[starts], 2), np.stack([low, high], axis=1).reshape(-1, *values.shape[1:])


def grids(*all_axes: Any) -> None:
    """Give axes a pale grid, and curves all of their width."""
    for axes in all_axes:
        axes.grid(alpha=0.3)
        axes.margins(x=0.01)
