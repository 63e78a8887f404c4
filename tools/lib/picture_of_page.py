"""Draws docs/pictures/view.png: the live page of a run, as a browser without a screen shows it.

    UNICON_ASSETS=… python tools/lib/picture_of_page.py [WORKFLOW [FILE.png]]

Needs the extras `sim` and `view`, Chromium, and `pip install playwright pillow`.
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CHROMIUM = "/usr/bin/chromium"
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)
SIZE = {"width": 1440, "height": 900}
MOMENT = 11.0
"""Of the run in [s] at which it is drawn: Go2 walks a bend."""


def main(workflow: str = "go2_walk", path: str = "docs/pictures/view.png") -> int:
    """Run a workflow, look at it, and write the picture."""
    from PIL import Image
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "unicon_ros", "run", workflow, "--view", "--duration", "60"]
    command += ["--set", "pacing.priority=50"]  # the browser draws without a GPU, beside the ticks
    run = subprocess.Popen([*command, "--view-port", "8790"], stderr=subprocess.PIPE, text=True)
    try:
        assert run.stderr is not None
        lines = iter(run.stderr.readline, "")
        found = next(filter(None, (re.search(r"view: (http\S+)", line) for line in lines)))
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
            tab = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
            tab.goto(found[1])
            moment = r"parseFloat((document.body.innerText.match(/\d+ · ([\d.]+) s/) ?? [0, 0])[1])"
            tab.get_by_text("Plots", exact=True).click(timeout=60_000)
            drawn = "Object.keys(window.__viserTestpoints.uplots ?? {}).length == 3"
            tab.wait_for_function(f"() => {drawn} && {moment} > {MOMENT}", timeout=60_000)
            # viser's own note that a machine without a GPU draws.
            tab.add_style_tag(content=".mantine-Notifications-root {display: none}")
            shot = tab.screenshot()
            browser.close()
    finally:
        run.terminate()
        run.wait(20.0)
    picture = Image.open(io.BytesIO(shot)).convert("RGB").quantize(255, dither=Image.Dither.NONE)
    (ROOT / path).parent.mkdir(parents=True, exist_ok=True)
    picture.save(ROOT / path, optimize=True)
    print(f"{path}: {(ROOT / path).stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
