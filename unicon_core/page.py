r"""Page: what all HTML pages of unicon share: one file that needs nothing beside it, no server.

    page("walk", "go2 on MuJoCo", [table(["joint", "limit\nrad"], [["FL_hip", "1.05"]])])

Light or dark as the reader has it; drawings take the page's colours by its CSS variables.
"""

from __future__ import annotations

import html
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import quote

from unicon_base import UniconError, cannot

STILL = "<!-- without uplot-python -->"
"""Stands in a page with curves that would be interactive if that package were there."""
QUESTIONS = (
    "Which joint",
    "When",
    "How fast",
    "Did it fall",
    "What was commanded",
    "Where is it recorded",
)
"""Of `answers`."""
ROOM = "give a path in a writable folder with room"
"""The remedy where a file cannot be written."""
_STYLE = """
:root { color-scheme: light dark; --text: #222; --pale: #666; --line: #ddd; --box: #f2f5fb;
        --mark: #1f4e9c; --page: #fff; --card: #fff; --flow: #f8fafc; --edge: #9ca3af;
        --hot: #c2410c; --hot-box: #fff7ed; }
@media (prefers-color-scheme: dark) { :root { --text: #ddd; --pale: #999; --line: #444;
        --box: #1c2533; --mark: #8ab4f8; --page: #121212; --card: #1b1b1b; --flow: #161a20;
        --edge: #6b7280; --hot: #fb923c; --hot-box: #2b1a0f; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--text); background: var(--page);
       margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.6em; margin-bottom: 0; } h2 { font-size: 1.2em; margin: 2em 0 .3em; }
figure { margin: 0; } figure svg { max-width: 100%; height: auto; }
figure svg * { stroke-linejoin: round; }
.sub, figcaption { color: var(--pale); } figcaption { margin-bottom: .6em; }
ul.findings { background: var(--box); border-left: 4px solid var(--mark);
              padding: .8em 1em .8em 2.2em; }
ul.findings li:first-child { font-weight: 600; } ul.findings.bad { border-color: var(--hot); }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: 13px; }
th, td { padding: .25em .7em; text-align: right; border-bottom: 1px solid var(--line); }
th { vertical-align: bottom; font-weight: 600; }
td:first-child, th:first-child { text-align: left; }
th small { color: var(--pale); font-weight: 400; }
.facts td, .words td, .words th { text-align: left; }
dl.answers { display: grid; grid-template-columns: max-content 1fr; gap: .15em .9em;
             margin: .8em 0; font-size: 14px; line-height: 1.4; }
dt { color: var(--pale); } dd { margin: 0; } dd, h1, code { overflow-wrap: anywhere; }
a { color: var(--mark); } code { user-select: all; font-size: 12px; }
td code { display: block; min-width: 22em; }
@media (max-width: 500px) { body { margin-top: .6em; } h1 { font-size: 1.25em; }
                            dl.answers { grid-template-columns: 6em 1fr; font-size: 13px; } }
.plots { display: grid;
         grid-template-columns: repeat(auto-fill, minmax(min(100%, var(--least)), 1fr)); }
.plots > div { min-width: 0; overflow: hidden; } .plots .u-series > * { padding: 1px; }
.plots .u-title, .plots .u-legend { font-size: 12px; margin: 0; text-align: left; }
.plots .u-select { background: rgba(128, 128, 128, .3); }
"""


class Html(str):
    """A text that is HTML already: cells and answers leave it as it is."""


def escaped(text: str) -> str:
    """Return a text as HTML."""
    return text if isinstance(text, Html) else html.escape(text)


def link(path: str | Path, folder: str | Path, text: str = "") -> Html:
    """Return a link to a file.

    Args:
        path: of the file.
        folder: of the page; the link is relative, so that both may be moved.
        text: of the link; the path unless given.
    """
    there = quote(os.path.relpath(path, folder))
    return Html(f'<a href="./{there}">{html.escape(text or place(path))}</a>')


def shell(command: str) -> Html:
    """Return a command that a click selects as a whole."""
    return Html(f"<code>{html.escape(command)}</code>")


def answers(*texts: str) -> str:
    """Return the answers to `QUESTIONS`, one each, which begin a page; texts are escaped."""
    rows = zip(QUESTIONS, texts, strict=True)
    return (
        f'<dl class="answers">{"".join(f"<dt>{q}</dt><dd>{escaped(a)}</dd>" for q, a in rows)}</dl>'
    )


def interactive() -> Path | None:
    """Return the folder of uPlot, which makes plots interactive; None where it is not installed."""
    found = find_spec("uplot")
    folder = Path(found.origin).parent / "static" if found and found.origin else None
    return folder if folder and (folder / "uPlot.iife.js").is_file() else None


def _plots(shown: str) -> str:
    """Return what draws the plots of a page, or how to get them."""
    folder = interactive()
    if STILL in shown:
        return (
            '<p class="sub">Curves to hover and zoom: pip install &#39;unicon_ros[pages]&#39;</p>'
        )
    if folder is None or '<div class="plots"' not in shown:
        return ""
    code, style = (
        (folder / name).read_text("utf-8") for name in ("uPlot.iife.js", "uPlot.min.css")
    )
    ours = Path(__file__).with_name("plots.js").read_text("utf-8")
    return f"<style>{style}</style><script>{code}</script><script>{ours}</script>"


def page(title: str, below: str, parts: Iterable[str], width: int = 1150) -> str:
    """Return a whole page that needs nothing beside it, light or dark as the reader has it.

    Args:
        title: of the window and of the page, not escaped yet.
        below: a line below the title, not escaped yet.
        parts: of the body, as HTML.
        width: of its text at most, [pixels].
    """
    shown = "\n".join(parts)
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<link rel="icon" href="data:,">',  # or browsers ask the server for one
            f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head>",
            f'<body style="max-width: {width}px"><h1>{html.escape(title)}</h1>',
            f'<p class="sub">{html.escape(below)}</p>',
            shown,
            f"{_plots(shown)}</body></html>\n",
        ]
    )


def figure(heading: str, caption: str, svg: str) -> str:
    """Return a drawing with heading and caption.

    Args:
        heading, caption: not escaped yet.
        svg: an `<svg>` element, which becomes a part of the page.
    """
    return (
        f"<h2>{html.escape(heading)}</h2><figure><figcaption>{html.escape(caption)}</figcaption>"
        f'<div class="wide" role="img" aria-label="{html.escape(heading)}">{svg}</div></figure>'
    )


def findings(texts: Iterable[str], *, bad: bool = False) -> str:
    """Return what stands out, in a box, the first line in bold; texts are escaped.

    Args:
        texts: a line each.
        bad: something went wrong, which the box shows.
    """
    kind = "findings bad" if bad else "findings"
    return f'<ul class="{kind}">{"".join(f"<li>{escaped(text)}</li>" for text in texts)}</ul>'


def pairs(facts: Mapping[str, str]) -> str:
    """Return a table of names and what is said of them; both are escaped, but for `Html`."""
    return f'<div class="wide"><table class="facts">{_rows(facts.items())}</table></div>'


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], *, words: bool = False) -> str:
    r"""Return a table; heads and cells are escaped.

    Args:
        heads: of the columns; what follows a `\n` is the unit, which stands below.
        rows: of cells.
        words: the cells are words, not figures: all columns begin at the left.
    """
    head = "".join(f"<th>{_head(text)}</th>" for text in heads)
    kind = ' class="words"' if words else ""
    return f'<div class="wide"><table{kind}><tr>{head}</tr>{_rows(rows)}</table></div>'


def _rows(rows: Iterable[Sequence[str]]) -> str:
    return "".join(
        f"<tr>{''.join(f'<td>{escaped(cell)}</td>' for cell in row)}</tr>" for row in rows
    )


def _head(text: str) -> str:
    head, _, unit = html.escape(text).partition("\n")
    return f"{head}<br><small>{unit}</small>" if unit else head


def place(path: str | Path) -> str:
    """Return a path to show: from the working folder on, where it lies below it."""
    shown = Path(path)
    return str(shown.relative_to(Path.cwd())) if shown.is_relative_to(Path.cwd()) else str(shown)


def number(value: float | None) -> str:
    """Return three digits of a number, – for what is none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.3g}"


def plain(value: Any) -> Any:
    """Return what JSON can have: lists, mappings by texts, and null for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def refuse_unwritable(path: Path) -> None:
    """Refuse a file that could not be written later, before any work is done for it.

    Raises:
        UniconError: it is a folder, or it or the folder that it would be in cannot be written.
    """
    there = next(each for each in (path, *path.absolute().parents) if each.exists())
    if path.is_dir() or (there != path and not there.is_dir()) or not os.access(there, os.W_OK):
        why = "it is a folder" if path.is_dir() else f"{there} cannot be written to"
        raise UniconError(f"cannot write {path}: {why}; give a path in a writable folder")


def refuse_existing(path: Path, what: str = "") -> None:
    """Refuse to write where something is, be it a link that points nowhere.

    Args:
        path: that is to be written.
        what: stands before it in the message, such as `"recording "`.

    Raises:
        UniconError: it exists.
    """
    if os.path.lexists(path):
        raise UniconError(f"{what}{path} exists; move it away or give another name")


def write_json(path: Path, value: Any, folders: bool = False) -> None:
    """Write a value as JSON; as `write_file`."""
    text = json.dumps(value, indent=2, ensure_ascii=False)
    write_file(path, f"{text}\n".encode(), folders)


def write_file(path: Path, content: bytes, folders: bool = False) -> None:
    """Write a file so that nobody ever sees half of it, with `folders` made as needed.

    Raises:
        UniconError: it cannot be written.
    """
    half = path.with_name(f".{path.name}.{os.getpid()}")
    with cannot(f"write {path}", ROOM):
        if path.exists() and not path.is_file():  # a device, which stays one
            path.write_bytes(content)
            return
        try:
            if folders:
                path.parent.mkdir(parents=True, exist_ok=True)
            half.write_bytes(content)
            half.replace(path)
        except OSError:
            with suppress(OSError):
                half.unlink(missing_ok=True)
            raise
