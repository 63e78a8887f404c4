"""The page in a browser: a mouse that pushes the robot, and the past with a branch from it."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import CHROMIUM, MISSING, Page, Run, chromium

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(240)]

if not CHROMIUM.exists():
    pytest.skip(MISSING, allow_module_level=True)
pytest.importorskip("playwright", reason=MISSING)
pytest.importorskip("viser", reason="no live page: pip install 'unicon_ros[view]'")

from test_push_page import STANDS, until  # noqa: E402

SIZE = 800, 360
"""Of the tab in [px]: a small one, since software draws it, and a page that is slow loses the
wheel."""
TRUNK = 0.5, 0.43
"""Where the trunk of a go2 is in the view, as a share of its size."""
SCENE = "window.__viserSceneTree.getState()"


@pytest.fixture
def seen(tmp_path: Path) -> Iterator[tuple[Run, Page]]:
    """A go2 that stands in the simulator, and a page in a browser that looks at it."""
    path = tmp_path / "stands.yaml"
    path.write_text(STANDS.format(platform="mujoco"))
    run = Run(path, fps=5.0)
    try:
        with chromium() as opened:
            page = Page(opened, run.address, *SIZE)
            page.until(f"{SCENE}['/world/body/1']")
            yield run, page
            assert page.errors == []
            assert page.hosts == {f"127.0.0.1:{run.port}"}
    finally:
        run.end()


def node(page: Page, name: str) -> dict[str, Any]:
    """Return a node of the scene as the browser has it."""
    plain = "(key, value) => ArrayBuffer.isView(value) ? [...value] : value"
    found: dict[str, Any] = json.loads(page.ask(f"JSON.stringify({SCENE}['{name}'], {plain})"))
    return found


def shown(page: Page, name: str) -> bool:
    return bool(node(page, name)["effectiveVisibility"])


def buttons(page: Page) -> list[str]:
    """Return the labels of the buttons that are there."""
    found: list[str] = page.ask("[...document.querySelectorAll('button')].map(b => b.innerText)")
    return found


def pushed(run: Run, page: Page) -> np.ndarray:
    """Take the wheel and drag the trunk to the right; return the force while the mouse holds."""
    page.until("document.body.innerText.includes('Take the wheel')")
    page.press("Take the wheel")
    page.until(f"{SCENE}['/world/body/1/shape_0'].dragBindings.length", 15.0)
    box, mouse = page.tab.locator("canvas").nth(1).bounding_box(), page.tab.mouse
    x, y = box["width"] * TRUNK[0], box["height"] * TRUNK[1]
    mouse.move(x - 1, y - 1)
    mouse.move(x, y)
    time.sleep(0.3)
    mouse.down()
    time.sleep(0.3)
    for step in range(1, 9):
        mouse.move(x + 12 * step, y)
        time.sleep(0.1)
    end = time.monotonic() + 3.0
    while not run.program.states["external_force"].any() and time.monotonic() < end:
        time.sleep(0.02)
    return np.array(run.program.states["external_force"])


def test_a_mouse_that_drags_the_trunk_pushes_it(seen: tuple[Run, Page]) -> None:
    run, page = seen
    states = run.program.states
    until(lambda: states["tick"] > 50)  # it has stood up
    for _ in range(3):
        time.sleep(3.0)  # software draws its first frames slowly
        if (force := pushed(run, page)).any():
            break
        page.tab.mouse.up()  # the page has lost the wheel, so that the mouse turned the view
        page.tab.reload()
    assert np.linalg.norm(force) > 5.0
    bodies: Callable[[], tuple[str, ...]] = run.program.platform.bodies  # type: ignore[attr-defined]
    assert bodies[int(states["external_force_body"])] == "base_link"  # type: ignore[index]
    page.until(f"{SCENE}['/world/force'].effectiveVisibility", 5.0)
    begin, end = np.reshape(node(page, "/world/force")["message"]["props"]["points"], (2, 3))
    along = (end - begin) / np.linalg.norm(end - begin)
    assert along @ (force / np.linalg.norm(force)) > 0.9
    newton = re.fullmatch(r"(\d+) N", node(page, "/world/newton")["message"]["props"]["text"])
    assert newton is not None
    assert shown(page, "/world/newton")
    assert 0.5 < float(newton[1]) / np.linalg.norm(force) < 2.0
    page.tab.mouse.up()
    until(lambda: not states["external_force"].any(), 5.0)
    page.until(f"!{SCENE}['/world/force'].effectiveVisibility", 5.0)
    assert not shown(page, "/world/newton")
    assert run.report is None  # and it stands as before
    until(lambda: states["projected_gravity"][2] < -0.95)


def height(name: str = "/world/body/1") -> str:
    """Return the JavaScript of the height at which a node is drawn, in [m]."""
    return f"window.__viserMutable.nodeRefFromName['{name}'].position.z"


def test_the_past_is_seen_and_a_branch_goes_on_from_it(seen: tuple[Run, Page]) -> None:
    run, page = seen
    states = run.program.states
    page.until("document.body.innerText.includes('Last minute')")
    until(lambda: states["tick"] > 150)
    page.tab.get_by_label("ghost").first.evaluate("each => each.click()")  # its folder is closed
    page.until(f"{SCENE}['/world/ghost']?.effectiveVisibility", 10.0)
    assert "Branch here" not in buttons(page)
    stands = page.ask(height())
    box = page.tab.locator("input").filter(visible=True)
    numbers = [box.nth(k) for k in range(box.count())]
    time_box = next(each for each in numbers if re.fullmatch(r"\d+\.?\d*", each.input_value()))
    time_box.fill("0.1")
    time_box.press("Enter")
    page.until("document.body.innerText.includes('PAST: ')")
    page.until(f"{height()} > {stands + 0.005}")  # it has not settled yet
    ticks, ghost = int(states["tick"]), page.ask(height("/world/ghost/1"))
    time.sleep(1.5)
    assert int(states["tick"]) > ticks + 30  # the run goes on
    assert page.ask(height("/world/ghost/1")) == ghost > stands + 0.005  # the ghost is of then, too
    assert page.ask(height()) > stands + 0.005
    page.press("Back to live")
    page.until("!document.body.innerText.includes('PAST: ')")
    page.until(f"{height()} < {stands + 0.005}")
    assert "Branch here" not in buttons(page)
    time_box.fill("1.0")
    time_box.press("Enter")
    page.until("document.body.innerText.includes('PAST: ')")
    before = int(states["tick"])
    page.press("Branch here")
    page.until("document.body.innerText.includes('the run goes on from ')")
    assert int(states["tick"]) < before
    page.until("!document.body.innerText.includes('PAST: ')")
    assert run.report is None
