"""What every page of ours must hold: whole, needing nothing beside it, and shown by a browser."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

VOID = {"meta", "link", "br", "img", "source"}
DRAWN = {"path", "rect", "use", "circle", "line", "image", "polygon"}

LOOK = """<script>
addEventListener("load", () => {
  const pictures = [...document.querySelectorAll("figure svg")].map(svg => [
    svg.parentNode.getAttribute("aria-label"), Math.round(svg.getBoundingClientRect().width),
    svg.querySelectorAll("path, rect").length]);
  document.body.dataset.told = JSON.stringify({pictures: pictures,
    rows: document.querySelectorAll("tr").length, wide: document.documentElement.scrollWidth,
    height: document.body.scrollHeight});
});
</script></body>"""
POLICY = (
    '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
    "style-src 'unsafe-inline'; script-src 'unsafe-inline'\">"
)
"""What would be asked for from elsewhere is refused, with a line on the console."""
FLAGS = (
    *("--headless", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
    "--no-sandbox",  # it wants rights that containers and root do not have
    "--host-resolver-rules=MAP * ~NOTFOUND",
)


class Page(HTMLParser):
    """A page, read: fails where a tag is not closed, or something is wanted from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.headings: list[str] = []
        self.pictures: dict[str, int] = {}
        """Of each picture how many strokes it has."""
        self.texts: list[str] = []
        self.scripts: list[str] = []
        self._open: list[str] = []
        self._ids: list[str] = []
        self._wanted: list[str] = []
        self._picture = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in ("iframe", "object", "embed"), tag
        assert tag != "script" or not any(name == "src" for name, _ in attrs)
        for name, value in attrs:
            assert not name.startswith("on"), (tag, name)
            text = value or ""
            if name in ("src", "href", "srcset", "xlink:href", "action", "data"):
                assert text.startswith(("data:", "#", "./")), (tag, name, text)
            self._wanted += re.findall(r"url\(#([^)]+)\)", text)
            if name.endswith("href") and text.startswith("#"):
                self._wanted.append(text[1:])
            if name == "id":
                self._ids.append(text)
            if name == "aria-label":
                self._picture = text
                self.pictures[text] = 0
        if tag in DRAWN and self._picture:
            self.pictures[self._picture] += 1
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self._open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self._open[-1] == tag, (self._open, tag)
        self._open.pop()

    def handle_data(self, data: str) -> None:
        if self._open[-1:] == ["script"]:
            self.scripts.append(data)
            if data.startswith('{"clock"'):
                self.pictures[self._picture] += data.count(",")
        elif data.strip() and "style" not in self._open:
            self.texts.append(data.strip())
        if self._open and self._open[-1] in ("h1", "h2", "h3"):
            self.headings.append(data)
        if self.tables and "table" in self._open and data.strip():
            self.tables[-1][-1][-1] += data

    @property
    def panels(self) -> list[dict[str, Any]]:
        """Every panel that uPlot draws, with its curves and its times as `time`."""
        groups = [json.loads(text) for text in self.scripts if text.startswith('{"clock"')]
        return [
            panel | {"time": group["x"][panel["x"]], "clock": group["clock"]}
            for group in groups
            for panel in group["panels"]
        ]

    def table(self, head: str) -> list[list[str]]:
        """Return the table whose first cell begins so."""
        return next(table for table in self.tables if table[0][0].startswith(head))

    @property
    def text(self) -> str:
        """All that is read on it."""
        return "\n".join(self.texts)


def read_page(text: str) -> Page:
    """Read a page and check that it is whole and self-contained."""
    page = Page()
    page.feed(text)
    page.close()
    assert page._open == [], "a tag is not closed"
    assert text.startswith("<!DOCTYPE html>")
    assert len(set(page._ids)) == len(page._ids), "an id stands twice"
    assert set(page._wanted) <= set(page._ids), set(page._wanted) - set(page._ids)
    assert "@import" not in text
    for script in page.scripts:  # comments name sources
        code = re.sub(r"^\s*(//|\*).*$", "", script, flags=re.MULTILINE)
        text = text.replace(script, code)
    assert not re.search(r"https?:(?!//www\.w3\.org/)|url\((?!#|[\"']?data:)", text)
    return page


QUESTIONS = (
    *(
        "Which joint",
        "When",
        "How fast",
        "Did it fall",
        "What was commanded",
        "Where is it recorded",
    ),
)


def answered(text: str) -> dict[str, str]:
    """Return the six answers of a page, which come before all that scrolls; their texts."""
    begin = text.index('<dl class="answers">')
    assert text.count('<dl class="answers">') == 1
    for later in ("<table", "<svg", "<figure", '<ul class="findings', 'class="plots"'):
        assert later not in text[:begin], later
    shown = text[begin : text.index("</dl>")]
    found = dict(re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", shown))
    assert tuple(found) == QUESTIONS
    answers = {k: html.unescape(re.sub(r"<[^>]*>", " ", each)).strip() for k, each in found.items()}
    assert all(len(each) > 8 for each in answers.values()), answers
    for forbidden in ("nan", "None", "inf "):
        assert forbidden not in " ".join(answers.values()), answers
    return answers


def first_screen(page: Path, check: Any = None) -> None:
    """Look at a page in a browser, on a phone and on a desk: the answers are on the first screen.

    Args:
        page: the file.
        check: gets the tab of the larger one.
    """
    sync = pytest.importorskip("playwright.sync_api")
    assert page.stat().st_size < 600_000
    with sync.sync_playwright() as playwright:
        shown = playwright.chromium.launch(executable_path=browser(), args=[*FLAGS])
        for width, height in ((390, 844), (1280, 800)):
            tab = shown.new_page(viewport={"width": width, "height": height})
            said: list[str] = []
            tab.on("console", lambda line, said=said: said.append(line.text))
            tab.on("pageerror", lambda error, said=said: said.append(str(error)))
            tab.on("request", lambda asked, said=said: said.append(asked.url))
            tab.goto(page.as_uri())
            boxes = [each.bounding_box() for each in tab.locator("dl.answers > *").all()]
            assert len(boxes) == 12
            for box in boxes:
                assert box is not None
                assert box["x"] >= 0
                assert box["x"] + box["width"] <= width
                assert box["y"] + box["height"] <= height
            assert tab.evaluate("document.documentElement.scrollWidth") == width
            if check is not None and width == 1280:
                check(tab)
            assert [each for each in said if not each.startswith(("file:", "data:"))] == []
            assert sum(each.startswith("file:") for each in said) == 1
        shown.close()


def browser() -> str:
    """Return the command of a Chromium; skips the test where there is none."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if found := shutil.which(name):
            return found
    pytest.skip("no browser to look at the page with: apt install chromium (Debian)")


def looked_at(page: str, folder: Path) -> tuple[dict[str, Any], list[str]]:
    """Open a page; return what it tells of itself, and the lines of the console."""
    assert page.count("</body>") == 1
    path = folder / "looked_at.html"
    head = page.replace("<head>", f"<head>{POLICY}")
    assert head != page
    path.write_text(head.replace("</body>", LOOK), "utf-8")
    done = subprocess.run(
        [
            *(browser(), *FLAGS, f"--user-data-dir={folder / 'profile'}", "--window-size=1200,900"),
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
