"""A picture of a benchmark: p50 of each case as a dot, p99 at the end of its line, for the docs."""

from __future__ import annotations

from pathlib import Path

from unicon_core.errors import UniconError
from unicon_core.page import write_file
from unicon_ros.bench.report import Bench
from unicon_ros.report.drawing import as_png, require


def plot(bench: Bench, path: Path) -> None:
    """Write the picture.

    Dots stand where a value is; the length of a bar would say nothing on a logarithmic axis, which
    has no zero.

    Args:
        bench: what was measured; cases in other units than [µs] are left out.
        path: of the PNG.

    Raises:
        MissingDependencyError: matplotlib is not installed.
        UniconError: the benchmark's cases are not times, or the picture cannot be written.
    """
    require("--plot")
    from matplotlib.figure import Figure

    rows = {name: case for name, case in bench.cases.items() if "[" not in name}
    if not all("p50" in case for case in rows.values()):
        raise UniconError(f"bench {bench.name} measures no times to plot; leave --plot out")
    if bench.name == "latency":
        rows = {
            name: case for name, case in rows.items() if name.endswith(("end_to_end", "mirror"))
        }
    figure = Figure(figsize=(9.0, 0.42 * len(rows) + 1.2), layout="constrained")
    axes = figure.add_subplot()
    labels = list(rows)[::-1]
    p50 = [rows[label]["p50"] for label in labels]
    p99 = [rows[label]["p99"] for label in labels]
    colours = ["tab:blue" if "unicon" in label or "fused" in label else "0.65" for label in labels]
    axes.hlines(labels, p50, p99, color=colours, linewidth=1.5)
    axes.scatter(p50, labels, color=colours, zorder=3)
    axes.scatter(p99, labels, color=colours, marker="|", zorder=3)
    for place, value in enumerate(p50):
        axes.annotate(
            f"{value:,.0f}" if value >= 100 else f"{value:.3g}",
            (value, place),
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            fontsize=7,
        )
    axes.set_xscale("log")
    axes.set_xlabel("µs (dot: p50, end of the line: p99), log scale")
    axes.set_title(f"unicon bench {bench.name}, {bench.rounds} rounds")
    axes.grid(alpha=0.3)
    write_file(path, as_png(figure))
