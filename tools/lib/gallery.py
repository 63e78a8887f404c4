"""Makes docs/gallery.md: runs shipped workflows, draws them, and keeps the figures of each run.

    UNICON_ASSETS=… python tools/lib/gallery.py            # all, into docs/pictures/gallery/
    UNICON_ASSETS=… python tools/lib/gallery.py walk push

Needs the extras `video`, `sweep`, `ik`, and Chromium for the pages. The figures are those
of `figures.json`, which a test compares with the present run's.
"""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pictures_of_reports import NAMES, ROOT, Shot, take

FOLDER = ROOT / "docs" / "pictures" / "gallery"
LOOK = ("--size", "400x320", "--fps", "10")


@dataclass(frozen=True)
class Entry:
    """A picture of the gallery.

    Attributes:
        text: what it shows.
        command: as a reader may give it, with `--record FILE` or `--html FILE` to come.
        video: options of `unicon video`; none for a page.
        seconds: of the run.
    """

    text: str
    command: tuple[str, ...]
    video: tuple[str, ...] = ()
    seconds: float = 8.0


def span(begin: float, end: float) -> tuple[str, ...]:
    """Return the options of a part of a recording."""
    return ("--from", f"{begin:g}", "--to", f"{end:g}")


HAND = "left_hand_pose:z"
ENTRIES = {
    "walk": Entry(
        "Go2 walks under a velocity command",
        ("run", "go2_walk"),
        (*span(4.0, 10.0), "--ghost", "--plot", "base_lin_vel"),
        10.0,
    ),
    "push": Entry(
        "pushes of 0.8 m/s",
        ("run", "go2_walk", "--set", "scene.push={every: 2, velocity: 0.8}"),
        (*span(4.0, 10.0), "--plot", "base_lin_vel"),
        10.0,
    ),
    "stairs": Entry("a height scan climbs stairs", ("run", "go2_stairs"), span(5.0, 11.0), 12.0),
    "terrain": Entry(
        "rough ground",
        ("run", "go2_walk", "--set", "scene.terrain={rough: {height: 0.06}}"),
        span(4.0, 10.0),
        10.0,
    ),
    "reach": Entry(
        "G1's hands follow circles while it walks",
        ("run", "g1_reach"),
        (*span(2.0, 7.0), "--ghost", "--plot", HAND),
    ),
    "hands": Entry(
        "two Inspire hands on a G1",
        ("run", "g1_hands"),
        (*span(2.0, 6.0), "--plot", "joint_pos:L_index_proximal_joint"),
    ),
    "dance": Entry(
        "a motion policy between walks",
        ("run", "g1_dance"),
        (*span(4.0, 28.0), "--speed", "4"),
        30.0,
    ),
    "go1": Entry("Go1 with a policy of MuJoCo Playground", ("run", "go1_walk"), span(2.0, 7.0)),
    "sweep": Entry("on which ground it falls", ("sweep", "examples/terrain.yaml")),
    "diagnose": Entry("which payload a record was made with", ("diagnose", "real.mcap")),
}
"""Name to entry, in the order of the page."""


def unicon(*words: object, cwd: Path = ROOT) -> None:
    """Run a command of unicon."""
    command = [sys.executable, "-m", "unicon_ros", *map(str, words)]
    subprocess.run(command, cwd=cwd, check=True, timeout=900, stdout=subprocess.DEVNULL)


def made(name: str, folder: Path) -> dict[str, Any]:
    """Run an entry and return its figures; recording or page are NAME.mcap or NAME.html.

    Args:
        name: of `ENTRIES`.
        folder: takes the files.
    """
    entry, report = ENTRIES[name], folder / f"{name}.json"
    if name == "sweep":
        text = (ROOT / entry.command[1]).read_text("utf-8").replace("[0, 19]", "[0, 1]")
        (folder / "terrain.yaml").write_text(text, "utf-8")
        unicon(*("sweep", folder / "terrain.yaml", "--out", folder / "sweep"))
        shutil.copy(folder / "sweep" / "report.html", folder / "sweep.html")
        return sweep_figures(folder / "sweep")
    run = [*entry.command, "--no-ros", "--quiet", "--duration", entry.seconds]
    if name == "diagnose":
        payload = ["--set", "scene.payload.mass=4", "--duration", 12.0, "--speed", "max"]
        real = folder / "real.mcap"
        unicon("run", "go2_walk", "--no-ros", "--quiet", *payload, "--record", real)
        unicon("diagnose", real, "--html", folder / "diagnose.html", "--json", report)
        return diagnosed(report)
    run += ["--record", folder / f"{name}.mcap", "--report", report]
    unicon(*run, "--speed", "max")
    told = json.loads(report.read_text("utf-8"))
    figures = {key: told[key] for key in ("ticks", "ended", "fell")}
    figures["distance_m"] = round(math.hypot(*told["base_displacement_m"][:2]), 2)
    return figures


def diagnosed(report: Path) -> dict[str, Any]:
    """Return the likeliest cause of a diagnosis, and its size in its unit."""
    first = json.loads(report.read_text("utf-8"))["causes"][0]
    return {"cause": first["kind"], "size": round(first["size"], 1), "unit": first["unit"]}


def sweep_figures(folder: Path) -> dict[str, Any]:
    """Return how many rollouts a sweep had, and how many fell."""
    from pyarrow import parquet

    (shard,) = folder.glob("shard-*.parquet")  # one holds up to 1,000 rows
    times = parquet.read_table(shard)["fall_s"].to_pylist()  # None where it did not fall
    return {"rollouts": len(times), "falls": sum(time is not None for time in times)}


def draw(name: str, folder: Path) -> Path:
    """Draw what `made` left in a folder; return the picture."""
    entry = ENTRIES[name]
    FOLDER.mkdir(parents=True, exist_ok=True)
    if entry.video:
        picture = FOLDER / f"{name}.webp"
        unicon("video", folder / f"{name}.mcap", picture, *LOOK, *entry.video)
        return picture
    browser = next(filter(None, map(shutil.which, NAMES)), None)
    if browser is None:
        raise SystemExit("no browser; install one: apt install chromium (Debian)")
    picture = FOLDER / f"{name}.png"
    shot = Shot(entry.command, (1000, 900))
    take(browser, folder / f"{name}.html", shot, picture, folder / "profile")
    return picture


def page() -> str:
    """Return docs/gallery.md."""
    lines = ["# Gallery", "", "For people who look before they install. `make pictures` makes it."]
    lines += ["", "| | |", "|---|---|"]
    for name, entry in ENTRIES.items():
        words = (f"'{word}'" if " " in word else word for word in entry.command)
        picture = f"pictures/gallery/{name}.{'webp' if entry.video else 'png'}"
        lines.append(f"| ![{name}]({picture}) | {entry.text}: `unicon {' '.join(words)}` |")
    return "\n".join(lines) + "\n"


def main(*names: str) -> int:
    """Make the pictures that are named, else all."""
    if unknown := [name for name in names if name not in ENTRIES]:
        raise SystemExit(f"no picture {unknown[0]!r}; there are {', '.join(ENTRIES)}")
    kept = FOLDER / "figures.json"
    figures = json.loads(kept.read_text("utf-8")) if kept.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        for name in names or ENTRIES:
            figures[name] = made(name, Path(folder))
            picture = draw(name, Path(folder))
            print(f"{picture}: {picture.stat().st_size / 1e3:.0f} kB, {figures[name]}", flush=True)
    ordered = {name: figures[name] for name in ENTRIES if name in figures}
    kept.write_text(json.dumps(ordered, indent=2) + "\n", "utf-8")
    (ROOT / "docs" / "gallery.md").write_text(page(), "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
