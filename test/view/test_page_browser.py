"""The live page in a browser: what is seen, what is done, and how fast; needs Chromium."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from browser import CHROMIUM, MISSING, Page, Run, chromium, look

pytestmark = [pytest.mark.slow, pytest.mark.alone]

if not CHROMIUM.exists():
    pytest.skip(MISSING, allow_module_level=True)
pytest.importorskip("playwright", reason=MISSING)
pytest.importorskip("viser", reason="no live page: pip install 'unicon_ros[view]'")

Start = Callable[..., Run]

WALKS_ON = """\
schema: unicon.workflow/1
name: walks_on
robot: go2
platform: mujoco
policies: {walk: go2_velocity}
rate: 50
commands: [{velocity_command: {constant: [0.2, 0.0, 0.0]}}]
flow: {chain: [{pose: {to: stand, duration: 1.0}}, {policy: walk}]}
safety: [finite, joint_limits, tilt_stop]
"""

SLIDER = "[role=slider][aria-valuemin='-0.5'][aria-valuemax='1']"  # vx of Go2


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as opened:
        yield opened


@pytest.fixture(scope="module")
def walks_on(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("workflow") / "walks_on.yaml"
    path.write_text(WALKS_ON)
    return path


@pytest.fixture
def start() -> Iterator[Start]:
    runs: list[Run] = []

    def begin(*given: Any, **options: Any) -> Run:
        runs.append(Run(*given, **options))
        return runs[-1]

    yield begin
    for run in runs:
        run.end()


def picture(page: Page) -> bytes:
    """Return the canvas of the 3D view, as it is drawn."""
    found: bytes = page.tab.locator("canvas").nth(1).screenshot()
    return found


def curves(page: Page) -> list[list[float]]:
    """Return the newest moment and value of each chart's first curve."""
    charts = "Object.values(window.__viserTestpoints.uplots)"
    found: list[list[float]] = page.ask(
        f"{charts}.map(each => [each.chart.data[0].at(-1), each.chart.data[1].at(-1)])"
    )
    return found


def take_the_wheel(page: Page) -> None:
    page.until("document.body.innerText.includes('Take the wheel')")
    page.press("Take the wheel")
    page.until("document.body.innerText.includes('you drive')")


@pytest.mark.parametrize(("workflow", "joints"), [("go2_walk", "FR"), ("g1_walk", "left_hip")])
def test_a_robot_is_drawn_and_moves_and_its_plots_run(
    browser: Any, start: Start, workflow: str, joints: str
) -> None:
    run = start(workflow)
    page = Page(browser, run.address, 1100)
    page.press("Plots")
    page.until("document.body.innerText.includes('joint_pos: ')", 20.0)
    time.sleep(1.0)
    before, first = picture(page), curves(page)
    time.sleep(2.0)
    after, second = picture(page), curves(page)
    assert before != after
    assert len(first) >= 3
    for (one, _), (other, _) in zip(first, second):
        assert other > one + 0.5
    for text in ("joint_pos: ", "velocity, commanded dashed [m/s, rad/s]", f"{joints}_", "phase"):
        assert page.says(text)
    assert page.errors == []
    assert page.hosts == {f"127.0.0.1:{run.port}"}
    page.tab.close()


def test_a_slider_commands_within_a_tenth_of_a_second(
    browser: Any, start: Start, walks_on: Path
) -> None:
    run = start(walks_on, fps=5.0)
    page = Page(browser, run.address)
    take_the_wheel(page)
    page.ask(
        "(addEventListener('keydown', () => { window.pressed = performance.timeOrigin "
        "+ performance.now() }, true), 0)"
    )
    page.tab.locator(SLIDER).focus()
    delays = []
    for step in range(1, 8):
        page.tab.keyboard.press("ArrowRight")
        time.sleep(0.25)
        wanted, pressed = [round(0.01 * step, 3), 0.0, 0.0], page.ask("window.pressed") / 1e3
        delays.append(next(at for at, value in run.changes if value == wanted) - pressed)
    assert sorted(delays)[len(delays) // 2] <= 0.1, delays
    page.tab.close()


def test_the_estop_damps_within_a_tenth_of_a_second(
    browser: Any, start: Start, walks_on: Path
) -> None:
    delays = []
    for _ in range(3):  # the browser draws on the very cores on which the robot ticks
        run = start(walks_on, fps=5.0)
        page = Page(browser, run.address)
        pressed = page.press("E-STOP")
        assert run.wait().faults == ["emergency stop by a viewer"]
        delays.append(run.closed - pressed)
        page.tab.close()
    assert 0.0 < sorted(delays)[1] <= 0.1, delays


def test_the_swap_button_lets_the_shadow_drive_and_the_first_one_again(
    browser: Any, start: Start, tmp_path: Path
) -> None:
    path = tmp_path / "shadowed.yaml"
    path.write_text(WALKS_ON + "shadow: {walk: {path: go2_stairs, limit: 1.0}}\n")
    run = start(path, fps=5.0)
    page, share = Page(browser, run.address), run.program.states["shadow_walk_share"]
    page.until("[...document.querySelectorAll('button')].some(b => b.innerText.trim() === 'swap')")

    def pressed(reached: float, patience: float = 20.0) -> None:
        """Press until it is granted, as a person does."""
        end = time.monotonic() + patience
        while share != reached and time.monotonic() < end:
            page.press("swap")
            time.sleep(1.5)
        assert share == reached, run.lines

    pressed(1.0)
    assert page.says("shadow_walk takes over from walk")
    pressed(0.0)
    assert page.errors == []
    page.tab.close()
    assert run.end().extra["shadow"]["events"][:2] == ["shadow_walk takes over", "back to walk"]


def test_a_page_that_hangs_stops_driving_until_a_new_touch(
    browser: Any, start: Start, walks_on: Path
) -> None:
    run = start(walks_on, fps=5.0)
    page = Page(browser, run.address)
    take_the_wheel(page)
    page.tab.locator(SLIDER).focus()
    for _ in range(5):
        page.tab.keyboard.press("ArrowRight")
    time.sleep(0.3)
    assert run.command == [0.05, 0.0, 0.0]
    begin = page.ask(
        "{const begin = performance.now(); while (performance.now() - begin < 2000); "
        "return performance.timeOrigin + begin}"
    )
    stopped = next(at for at, value in run.changes if at > begin / 1e3 and value == [0.0, 0.0, 0.0])
    assert 0.2 < stopped - begin / 1e3 < 0.75
    time.sleep(0.5)
    page.until("document.body.innerText.includes('was silent')")
    assert run.command == [0.0, 0.0, 0.0]
    page.tab.keyboard.press("ArrowRight")
    time.sleep(0.5)
    assert run.command == [0.0, 0.0, 0.0]
    take_the_wheel(page)
    page.tab.locator(SLIDER).focus()
    page.tab.keyboard.press("ArrowRight")
    time.sleep(0.4)
    assert run.command == [0.01, 0.0, 0.0]
    page.tab.close()


def test_one_of_two_viewers_drives_by_keys_and_both_may_stop(
    browser: Any, start: Start, walks_on: Path
) -> None:
    run = start(walks_on, fps=3.0)
    one, other = (Page(browser, run.address) for _ in range(2))
    take_the_wheel(one)
    other.until("document.body.innerText.includes('Viewer 1 drives')")
    one.tab.mouse.click(410, 550)
    one.tab.keyboard.down("i")
    time.sleep(0.5)
    assert run.command == [0.5, 0.0, 0.0]  # half of 1 m/s
    one.tab.keyboard.up("i")
    time.sleep(0.4)
    assert run.command == [0.0, 0.0, 0.0]
    other.tab.keyboard.down("i")
    time.sleep(0.4)
    assert run.command == [0.0, 0.0, 0.0]
    other.press("pause")
    other.until("document.body.innerText.includes('only he may pause')")
    other.press("E-STOP")
    assert run.wait().faults == ["emergency stop by a viewer"]
    assert one.errors == other.errors == []
    one.tab.close()
    other.tab.close()


def test_it_comes_back_after_a_restart_with_another_robot(
    browser: Any, start: Start, walks_on: Path
) -> None:
    run = start(walks_on)
    page = Page(browser, run.address)
    page.until("document.body.innerText.includes('walks_on')")
    run.end()
    page.until("document.getElementById('unicon-estop').textContent === 'NO CONNECTION'")
    page.errors.clear()
    again = start("g1_walk", run.port)
    took = page.until("document.getElementById('unicon-estop').textContent === 'E-STOP'")
    assert again.address == run.address
    assert took <= 2.0
    page.press("Plots")
    page.until("document.body.innerText.includes('left_hip_pitch_joint')")
    assert page.says("g1_walk")
    assert not page.says("walks_on")
    # The browser itself notes each try at a port where nobody listened.
    assert [each for each in page.errors if "ERR_CONNECTION_REFUSED" not in each] == []
    page.tab.close()


def test_only_its_own_pages_are_let_in(start: Start) -> None:
    from websockets.exceptions import ConnectionClosedError
    from websockets.sync.client import connect

    run = start("go2_walk", token="s3cretword")
    own, protocols = f"http://127.0.0.1:{run.port}", ["viser-v1.1.1"]
    for origin, path, there in (
        (own, "/s3cretword", True),
        (own, "/", False),
        ("http://evil.example", "/s3cretword", False),
    ):
        url = f"ws://127.0.0.1:{run.port}{path}"
        with connect(url, origin=origin, subprotocols=protocols, max_size=None) as socket:  # type: ignore[arg-type]
            if there:
                assert len(socket.recv(timeout=5.0)) > 100
            else:
                with pytest.raises(ConnectionClosedError, match="1008"):
                    socket.recv(timeout=5.0)


def test_the_address_with_its_token_opens_the_page(
    browser: Any, start: Start, walks_on: Path
) -> None:
    run = start(walks_on, token="s3cretword", fps=5.0)
    assert run.address.endswith("/s3cretword")
    page = Page(browser, run.address)
    page.until("document.body.innerText.includes('phase')")
    assert page.errors == []
    page.tab.close()


def test_viewers_that_hang_take_no_picture_from_one_that_draws(
    start: Start, walks_on: Path
) -> None:
    run = start(walks_on)
    counts = {}
    for stalled in (0, 4):
        with ThreadPoolExecutor(5) as pool:
            others = [pool.submit(look, run.port, 5.0, False) for _ in range(stalled)]
            seen = look(run.port, 5.0, True)
            for other in others:
                other.result()
        counts[stalled] = len([at for at in seen if at > seen[0] + 1.0])
    assert counts[0] > 40
    assert counts[4] > 0.7 * counts[0], counts
    assert max(counts.values()) < 4.5 * 36  # the cap of 30 a second
