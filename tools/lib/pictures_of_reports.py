"""Makes the pictures of docs/howto/reports.md: runs what they show in headless Chromium.

    .venv/bin/python tools/lib/pictures_of_reports.py         # all, into docs/pictures/
    .venv/bin/python tools/lib/pictures_of_reports.py --out /tmp report

Needs Chromium (apt install chromium), and what unicon's pages need (matplotlib, MuJoCo).
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    *("--headless", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--hide-scrollbars"),
    "--no-sandbox",  # it wants rights that containers and root do not have
    "--host-resolver-rules=MAP * ~NOTFOUND",
)
COLOURS = 128
"""Of a picture: drawings have few, and the file is a third as large."""


@dataclass(frozen=True)
class Shot:
    """A picture.

    Attributes:
        command: of unicon, which writes the page; the page's path is put behind it.
        size: of the browser's window, [pixels].
    """

    command: tuple[str, ...]
    size: tuple[int, int]


RUN = ("run", "go2_walk", "--no-ros", "--quiet", "--report")
SHOTS = {
    "report": Shot(RUN, (1200, 1300)),
    "show": Shot(("show", "go2_walk", "--html"), (1500, 1300)),
}
"""Name of a picture to what it shows; runs take place in real time."""


def main() -> int:
    """Make the pictures that are named, all unless told."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SHOTS)}")
    parser.add_argument(
        "--out",
        type=Path,
        default=ROOT / "docs" / "pictures",
        help="folder (default: docs/pictures/)",
    )
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.names if name not in SHOTS]:
        parser.error(f"no picture {unknown[0]!r}; there are {', '.join(SHOTS)}")
    browser = next(filter(None, map(shutil.which, NAMES)), None)
    if browser is None:
        parser.error("no browser; install one: apt install chromium (Debian)")
    arguments.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        pages: dict[tuple[str, ...], Path] = {}
        for name in arguments.names or SHOTS:
            shot = SHOTS[name]
            if shot.command not in pages:
                pages[shot.command] = Path(folder) / f"{name}.html"
                write_page(shot.command, pages[shot.command])
            picture = arguments.out / f"{name}.png"
            take(browser, pages[shot.command], shot, picture, Path(folder) / "profile")
            print(f"{picture}: {picture.stat().st_size / 1e3:.0f} kB")
    return 0


def write_page(command: tuple[str, ...], page: Path) -> None:
    """Let unicon write a page."""
    subprocess.run(
        [sys.executable, "-m", "unicon_ros", *command, str(page)], cwd=ROOT, check=True, timeout=120
    )


def take(browser: str, page: Path, shot: Shot, picture: Path, profile: Path) -> None:
    """Take a picture of a page; what the page says on the console is an error."""
    done = subprocess.run(
        [
            *(browser, *FLAGS, f"--user-data-dir={profile}"),
            f"--window-size={shot.size[0]},{shot.size[1]}",
            *("--enable-logging=stderr", "--v=0", f"--screenshot={picture}", page.as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    if said := [line for line in done.stderr.splitlines() if "CONSOLE" in line]:
        raise SystemExit(f"{page.name} says on the console: {said[0]}")
    squeeze(picture)


def squeeze(picture: Path) -> None:
    """Write a picture with few colours."""
    from PIL import Image  # comes with matplotlib

    with Image.open(picture) as image:
        few = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    few.save(picture, optimize=True)


if __name__ == "__main__":
    sys.exit(main())
