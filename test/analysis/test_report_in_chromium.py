"""The report in a real browser: every picture is there, and the console stays silent."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from made_runs import save, walk

from unicon_ros.analysis.pictures import PICTURES
from unicon_ros.cli.main import main

pytestmark = pytest.mark.slow

LOOK = """<script>
addEventListener("load", () => {
  const told = [...document.images].map(image => [image.alt, image.naturalWidth, image.width]);
  const rows = [...document.querySelectorAll("tr")].length;
  document.body.dataset.told = JSON.stringify({images: told, rows: rows,
    wide: document.documentElement.scrollWidth, height: document.body.scrollHeight});
});
</script></body>"""
FLAGS = (
    *("--headless", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
    "--no-sandbox",  # it wants rights that containers and root do not have
    "--host-resolver-rules=MAP * ~NOTFOUND",
)


@pytest.fixture(scope="module")
def chromium() -> str:
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if found := shutil.which(name):
            return found
    pytest.skip("no browser to look at the report with: apt install chromium (Debian)")


def seen(chromium: str, page: str, folder: Path) -> tuple[dict[str, list[list[object]]], list[str]]:
    """Open a page; return what it tells of its pictures, and the lines of the console."""
    assert page.count("</body>") == 1
    path = folder / "looked_at.html"
    path.write_text(page.replace("</body>", LOOK), "utf-8")
    done = subprocess.run(
        [
            *(chromium, *FLAGS, f"--user-data-dir={folder / 'profile'}", "--window-size=1200,900"),
            *("--enable-logging=stderr", "--v=0", "--virtual-time-budget=5000", "--dump-dom"),
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    told = re.search(r'data-told="([^"]+)"', done.stdout)
    assert told is not None, done.stdout[-2000:] + done.stderr[-2000:]
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(html.unescape(told.group(1))), console


def test_every_picture_is_there_and_the_console_is_silent(chromium: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    files = [str(save(tmp_path / f"{n}.npz", walk(seed=n))) for n in range(2)]
    assert main(["analyze", *files, "--out", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    told, console = seen(chromium, page, tmp_path)
    assert console == []
    headings = [heading for name, (_, heading, _) in PICTURES.items()]
    assert [alt for alt, *_ in told["images"]] == headings
    for alt, natural, shown in told["images"]:
        assert natural > 600, alt
        assert 300 < shown <= natural, alt
    assert told["rows"] > 12
    assert told["wide"] <= 1200  # nothing hangs out of the window
    assert told["height"] > 2000


def test_a_broken_picture_and_an_error_would_be_seen(chromium: str, tmp_path: Path) -> None:
    page = (
        '<!DOCTYPE html><html><body><img alt="x" src="data:image/png;base64,AAAA">'
        "<script>console.error('told'); nothing.at.all</script></body></html>"
    )
    told, console = seen(chromium, page, tmp_path)
    assert told["images"][0][:2] == ["x", 0]
    assert len(console) == 2
