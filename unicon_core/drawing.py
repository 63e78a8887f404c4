"""Drawings of pages: curves that a reader hovers and zooms, by uPlot; all others, and PNGs, by
matplotlib. They take the colours of a page, light or dark."""

from __future__ import annotations

import html
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from unicon_base import imported
from unicon_base.arrays import Array
from unicon_core.page import STILL, interactive, plain, write_file
from unicon_core.page import figure as figure_html

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, MARK, PALE = "#222221", "#1f4e9c", "#8c8c8d"
"""Text and axes, what is looked at first, what stands behind it. They follow the page."""
COLOURS = (MARK, "#d55e00", "#009e73", "#b3589a", "#2f9bd6", "#b58900")
"""Of curves, in their order: colour-blind readers tell them apart, on white and on black."""
_PAPER = "#fefefd"
ROOM = 16_000
"""Values of a picture, so that a page of six stays below 600 kB."""
ZOOM_S = 3.0
"""Length of the stretch of `worst` in [s]."""

Pictures = Mapping[str, tuple[Callable[..., bool], str, str]]
"""Name to what fills a figure, as of `drawn`, heading and caption, in the order of a page."""

_FOLLOWS = {INK: "--text", MARK: "--mark", PALE: "--pale", _PAPER: "--page"}
_LOOKS = str(Path(__file__).with_name("drawing.mplstyle"))


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
        text = text.replace(colour, f"var({follows})")
    return text


def _short(way: re.Match[str]) -> str:
    """Return a way to a hundredth of a point, on one line."""
    return re.sub(r"(\.\d\d)\d+", r"\1", " ".join(way[0].split()))


@dataclass(frozen=True)
class Curve:
    """One curve.

    Attributes:
        label: of it in the legend.
        colour: of `COLOURS`, or another.
        time: of its samples, rising, shape (n,); empty for a constant.
        values: in the panel's unit, shape (n,), NaN or infinite where the curve has a gap; of a
            constant its value, shape (1,).
        dash: lengths of stroke and space in [pixels]; empty for a whole line.
    """

    label: str
    colour: str
    time: Array
    values: Array
    dash: tuple[float, ...] = ()


@dataclass(frozen=True)
class Panel:
    """Curves that share their axes; several panels of a picture share the axis of time.

    Attributes:
        title: of the panel.
        unit: of the values; "" for none.
        curves: in the order in which they are drawn.
        shaded: stretches of time that are grey, from and to.
    """

    title: str
    unit: str
    curves: Sequence[Curve]
    shaded: Sequence[tuple[float, float]] = ()


def limits(label: str, *values: float) -> list[Curve]:
    """Return dotted constants, those that are finite."""
    none = np.zeros(0)
    return [Curve(label, PALE, none, np.array([v]), (2, 3)) for v in values if math.isfinite(v)]


@dataclass(frozen=True)
class Lines:
    """A picture of panels: for a page, or as one of `Pictures`.

    Attributes:
        of: returns the panels of what is drawn; none where there is nothing to show.
        clock: what the axis of time is called, with its unit; pictures of one are linked.
        columns: of panels.
        height: of a panel in [inches].
    """

    of: Callable[..., Iterable[Panel]]
    clock: str = "time [s]"
    columns: int = 1
    height: float = 1.9

    def panels(self, *of: Any) -> list[Panel]:
        """Return the panels that have a number, their curves as few values as there is room for.

        Of a longer curve the lowest and the highest value of each stretch stay, so no peak is lost.
        """
        panels = [each for each in self.of(*of) if any(map(_finite, each.curves))]
        room = ROOM // max(1, sum(len(each.curves) for each in panels))
        return [
            replace(each, curves=[envelope(c, room // 2) for c in each.curves]) for each in panels
        ]

    def __call__(self, figure: Any, *of: Any) -> bool:
        """Draw the panels into a figure of matplotlib."""
        panels = self.panels(*of)
        if not panels:
            return False
        lines = math.ceil(len(panels) / self.columns)
        figure.set_size_inches(12.0, 0.7 + self.height * lines)
        every = figure.subplots(lines, self.columns, squeeze=False, sharex=True).reshape(-1)
        for axes in every[len(panels) :]:
            axes.set_axis_off()
        for axes, panel in zip(every, panels):
            draw(axes, panel)
        handles = {k: h for axes in every for h, k in zip(*axes.get_legend_handles_labels())}
        figure.legend(handles.values(), handles, loc="outside upper right", ncols=4)
        figure.supxlabel(self.clock)
        return True

    def html(self, *of: Any) -> str:
        """Return an element of a page with the panels; "" for none."""
        panels, grids = self.panels(*of), dict[tuple[float, ...], int]()
        shown = []
        for panel in panels:
            time = np.unique(np.concatenate([c.time[np.isfinite(c.time)] for c in panel.curves]))
            at = grids.setdefault(tuple(np.round(time, 5).tolist()), len(grids))
            curves = [
                {
                    "label": c.label,
                    "colour": _FOLLOWS.get(c.colour, c.colour),
                    "dash": c.dash,
                    "y": plain([float(f"{y:.4g}") for y in _at(time, c).tolist()]),
                }
                for c in panel.curves
            ]
            shaded = plain([list(map(float, each)) for each in panel.shaded])
            said = {"title": panel.title, "unit": panel.unit, "x": at, "shaded": shaded}
            shown.append(said | {"curves": curves})
        content = {"clock": self.clock, "height": 85 * self.height, "x": [*grids], "panels": shown}
        # A name with </script> would end the element.
        text = json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
        least = 300 if self.columns > 1 else 2000
        script = f'<script type="application/json">{text}</script>'
        return f'<div class="plots" style="--least:{least}px">{script}</div>' if panels else ""


def _finite(curve: Curve) -> bool:
    return len(curve.time) > 0 and bool(np.isfinite(curve.values).any())


def _at(time: Array, curve: Curve) -> Array:
    """Return a curve's values at other times that hold its own: the line between is the same."""
    if not len(curve.time):
        return curve.values
    return np.interp(time, curve.time, curve.values, math.nan, math.nan)


def envelope(curve: Curve, points: int) -> Curve:
    """Return a curve with at most two values, or three beside gaps, for each of some stretches.

    Args:
        curve: to draw; its infinite values become gaps.
        points: stretches of which the lowest and the highest value stay.
    """
    values = np.where(np.isfinite(curve.values), curve.values, math.nan)
    count = len(values)
    if count <= 2 * points:
        return replace(curve, values=values)
    starts = np.arange(0, count, math.ceil(count / points))
    rows = [each.reduceat(values, starts) for each in (np.fmin, np.fmax)]
    if np.isnan(values).any():
        rows.append(np.add.reduceat(values, starts) * 0.0 + rows[1])
    ends = np.append(starts[1:], count) - 1
    times = np.linspace(curve.time[starts], curve.time[ends], len(rows), axis=1)
    return replace(curve, time=times.reshape(-1), values=np.stack(rows, axis=1).reshape(-1))


def draw(axes: Any, panel: Panel) -> None:
    """Draw a panel with matplotlib."""
    for c in panel.curves:
        look = {"color": c.colour, "label": c.label, "linestyle": (0, c.dash) if c.dash else "-"}
        if len(c.time):
            axes.plot(c.time, c.values, **look)
        else:
            axes.axhline(c.values[0], **look)
    for begin, end in panel.shaded:
        axes.axvspan(begin, end, color="0.5", alpha=0.15)
    axes.set_title(panel.title, loc="left")
    axes.set_ylabel(f"[{panel.unit}]")


def worst(squares: Array, period: float, begin: float = 0.0) -> tuple[float, float]:
    """Return from when to when squares are largest together, `ZOOM_S` at most, in [s].

    Args:
        squares: by which each sample differs, shape (samples,).
        period: between two samples in [s].
        begin: time of the first one in [s].
    """
    count = min(len(squares), max(2, round(ZOOM_S / period)))
    sums = np.concatenate([[0.0], np.cumsum(squares)])
    first = int(np.argmax(sums[count:] - sums[:-count]))
    return begin + period * first, begin + period * (first + count)


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
            shown = fill.html(*of) if isinstance(fill, Lines) and interactive() else ""
            figure = None if shown and folder is None else drawn(fill, *of)
            if figure is not None and not shown:
                shown = as_svg(figure, name) + STILL * isinstance(fill, Lines)
            if not shown:
                continue
            shown = figure_html(heading, caption, shown)
        except Exception as error:
            why = f"could not be drawn: {type(error).__name__}: {error}"
            yield name, f"<h2>{html.escape(heading)}</h2><p>{html.escape(why)}</p>"
            continue
        if folder is not None and figure is not None:
            write_file(folder / f"{name}.png", as_png(figure))
        yield name, shown
