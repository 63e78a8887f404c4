"""`unicon view BAG` in a real browser: it is where the slider says, plays, asks nobody else."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pages import browser

from unicon_ros.cli.main import main

pytestmark = pytest.mark.slow

FLAGS = (
    *("--no-sandbox", "--disable-quic", "--disable-background-networking"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    pytest.importorskip("viser", reason="pip install 'unicon_ros[view]'")
    bag = tmp_path / "walk.mcap"
    assert main(["run", "go2_walk", "--speed", "max", "--no-ros", "--quiet", "--duration", "8",
                 "--record", str(bag)]) == 0  # fmt: skip
    command = [sys.executable, "-m", "unicon_ros", "view", str(bag), "--view-fps", "5"]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert run.stdout is not None
        run.stdout.readline()
        yield run.stdout.readline().split()[1]
    finally:
        run.terminate()
        run.wait(10.0)


def test_the_slider_chooses_the_tick_and_play_goes_on(address: str) -> None:
    playing = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    with playing.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=browser(), args=FLAGS)
        page = chromium.new_page(viewport={"width": 1280, "height": 900})
        said: list[str] = []
        asked: list[str] = []
        page.on("console", lambda line: said.append(line.text) if line.type == "error" else None)
        page.on("request", lambda request: asked.append(request.url))
        page.goto(address)

        def tick() -> int:
            found = re.search(r"tick\s+(\d+) · ", page.inner_text("body"))
            return -1 if found is None else int(found[1])

        def until(holds: Any, patience: float = 30.0) -> None:
            end = time.monotonic() + patience
            while not holds():
                assert time.monotonic() < end, page.inner_text("body")
                time.sleep(0.2)

        until(lambda: tick() >= 0)
        text = page.inner_text("body")
        assert "go2_walk · go2 · mujoco" in text
        assert "recording walk.mcap" in text
        assert not re.search(r"busy\s+p50", text)  # nobody has timed it
        pause = page.get_by_role("button", name="Pause")
        if pause.count():  # it has not come to its end by now
            pause.click()
        box = page.locator("input").filter(visible=True)
        numbers = [box.nth(k) for k in range(box.count())]
        of_time = next(each for each in numbers if re.fullmatch(r"\d+\.\d\d", each.input_value()))
        of_time.fill("2.00")
        of_time.press("Enter")
        until(lambda: tick() == 100)
        time.sleep(3.0)
        assert tick() == 100
        page.get_by_role("button", name="Play").click()
        until(lambda: tick() > 110)
        foreign = [url for url in asked if not url.startswith((address, "data:", "blob:"))]
        assert foreign == []
        assert said == []
        chromium.close()
