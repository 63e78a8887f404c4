"""Drawings by matplotlib, for pages and as PNGs; they take the colours of a page, light or dark."""

from __future__ import annotations

import html
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from unicon_base import AnyDict, imported
from unicon_base.arrays import Array
from unicon_core.page import figure as figure_html
from unicon_core.page import write_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, MARK, PALE = "#222221", "#1f4e9c", "#b8b8b8"
"""Text and axes, what is looked at first, what stands behind it. The first two follow the page."""
_PAPER = "#fefefd"
POINTS = 1500
"""Of a curve: of more than twice as many the lowest and the highest of each stretch are drawn."""
ZOOM_S = 3.0
"""Length of the stretch that `zoomed` draws larger in [s]."""

Pictures = Mapping[str, tuple[Callable[..., bool], str, str]]
"""Name to what fills a figure, as of `drawn`, heading and caption, in the order of a page."""

_FOLLOWS = {INK: "currentColor", MARK: "var(--mark)", _PAPER: "var(--page)"}
_LOOKS: AnyDict = {
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor"), INK),
    **dict.fromkeys(("xtick.color", "ytick.color", "axes.titlecolor"), INK),
    **dict.fromkeys(("figure.facecolor", "axes.facecolor"), "none"),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 8),
    **dict.fromkeys(("axes.grid", "axes.axisbelow"), True),
    "axes.titlesize": 10,
    "axes.xmargin": 0.01,
    "figure.labelsize": 9,
    "legend.facecolor": _PAPER,
    "lines.linewidth": 0.9,
    "grid.alpha": 0.3,
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
    imported("matplotlib", what, "plots")


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


def envelope(time: Array, values: Array, points: int = POINTS) -> tuple[Array, Array]:
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


def curve(
    axes: Any,
    time: Array,
    values: Array,
    colour: str | None = None,
    label: Any = None,
    points: int = POINTS,
    **look: Any,
) -> None:
    """Draw `envelope` of a curve, or of several."""
    axes.plot(*envelope(time, values, points), color=colour, label=label, **look)


def grid(figure: Any, count: int, columns: int, height: float, **shared: Any) -> Any:
    """Return small axes in rows, and make the figure fit them.

    Args:
        figure: that has none yet.
        count: of axes.
        columns: of them in a row.
        height: of a row in [inches].
        shared: as of `Figure.subplots`.
    """
    lines = math.ceil(count / columns)
    figure.set_size_inches(12.0, 0.7 + height * lines)
    every = figure.subplots(lines, columns, squeeze=False, **shared).reshape(-1)
    for axes in every[count:]:
        axes.set_axis_off()
    return every[:count]


def zoomed(
    figure: Any,
    names: Sequence[str],
    curves: Sequence[tuple[str, str, Array]],
    squares: Array,
    period: float,
    begin: float = 0.0,
    clock: str = "time [s]",
) -> None:
    """Draw joints over time, a row each, and the stretch that differs most once more at the right.

    Args:
        figure: that is filled.
        names: of the joints.
        curves: label, colour and values of each in [rad], shape (samples, joints).
        squares: by which a sample differs, shape (samples, joints).
        period: between two samples in [s].
        begin: time of the first one in [s].
        clock: what the axis of time is called.
    """
    figure.set_size_inches(12.0, 0.7 + 1.7 * len(names))
    rows = figure.subplots(len(names), 2, squeeze=False, width_ratios=[2.0, 1.0])
    count = min(len(squares), max(2, round(ZOOM_S / period)))
    for k, (left, right) in enumerate(rows):
        sums = np.concatenate([[0.0], np.cumsum(squares[:, k])])
        worst = int(np.argmax(sums[count:] - sums[:-count]))
        for axes, first, last in ((left, 0, None), (right, worst, worst + count)):
            for label, colour, values in curves:
                seen = values[first:last, k]
                time = begin + period * (first + np.arange(len(seen)))
                curve(axes, time, seen, colour, label)
        left.axvspan(*(begin + period * (worst + np.array([0, count]))), color="0.5", alpha=0.15)
        left.set_title(names[k], loc="left")
        left.set_ylabel("[rad]")
    rows[0][0].legend(loc="upper right", ncols=len(curves))
    rows[0][1].set_title(f"the {count * period:.3g} s that differ most")
    for axes in rows[-1]:
        axes.set_xlabel(clock)


def drawings(
    pictures: Pictures, *of: Any, folder: Path | None = None, tell: Callable[[str], object] = bool
) -> Iterator[tuple[str, str]]:
    """Yield name and HTML of each picture in which there is something to show.

    Instead of one that cannot be drawn the HTML says why: the rest of the page is shown for all
    that.

    Args:
        pictures: the pictures.
        of: what they show.
        folder: where a PNG of each is written, too.
        tell: takes what is being drawn.

    Raises:
        UniconError: a PNG cannot be written.
    """
    for name, (fill, heading, caption) in pictures.items():
        tell(f"drawing {name}")
        try:
            figure = drawn(fill, *of)
            if figure is None:
                continue
            shown = figure_html(heading, caption, as_svg(figure, name))
        except Exception as error:
            why = f"could not be drawn: {type(error).__name__}: {error}"
            yield name, f"<h2>{html.escape(heading)}</h2><p>{html.escape(why)}</p>"
            continue
        if folder is not None:
            write_file(folder / f"{name}.png", as_png(figure))
        yield name, shown
