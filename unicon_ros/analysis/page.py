"""Page: what the reports of `unicon analyze` and `unicon transfer` share; one file, no server."""

from __future__ import annotations

import base64
import html
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from unicon_core.errors import UniconError

__all__ = ["figure", "number", "page", "table", "write_file"]

_STYLE = """
:root { color-scheme: light dark; --text: #222; --pale: #666; --line: #ddd; --box: #f2f5fb;
        --mark: #1f4e9c; --page: #fff; }
@media (prefers-color-scheme: dark) { :root { --text: #ddd; --pale: #999; --line: #444;
        --box: #1c2533; --mark: #8ab4f8; --page: #121212; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--text); background: var(--page);
       margin: 2em auto; max-width: 1150px; padding: 0 1em; }
h1 { font-size: 1.6em; margin-bottom: 0; } h2 { font-size: 1.2em; margin: 2em 0 .3em; }
img { max-width: 100%; } .sub, figcaption { color: var(--pale); } figure { margin: 0; }
figcaption { margin-bottom: .6em; }
ul.findings { background: var(--box); border-left: 4px solid var(--mark);
              padding: .8em 1em .8em 2.2em; }
ul.findings li:first-child { font-weight: 600; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: 13px; }
th, td { padding: .25em .7em; text-align: right; border-bottom: 1px solid var(--line); }
th { vertical-align: bottom; font-weight: 600; }
td:first-child, th:first-child { text-align: left; }
th small { color: var(--pale); font-weight: 400; } .facts td { text-align: left; }
"""


def page(title: str, parts: Iterable[str]) -> str:
    """Return a whole page that needs nothing beside it, light or dark as the reader has it.

    Args:
        title: of the window, not escaped yet.
        parts: of the body, as HTML.
    """
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<link rel="icon" href="data:,">',  # or browsers ask the server for one
            f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>",
            *parts,
            "</body></html>\n",
        ]
    )


def figure(heading: str, caption: str, picture: bytes, dark: bytes | None = None) -> str:
    """Return a PNG with heading and caption.

    Args:
        heading, caption: not escaped yet.
        picture: shown on a light page, and on a dark one where there is no other.
        dark: shown on a dark page.
    """
    other = (
        ""
        if dark is None
        else (f'<source media="(prefers-color-scheme: dark)" srcset="{_data(dark)}">')
    )
    return (
        f"<h2>{html.escape(heading)}</h2><figure><figcaption>{html.escape(caption)}</figcaption>"
        f'<picture>{other}<img alt="{html.escape(heading)}" src="{_data(picture)}"></picture>'
        "</figure>"
    )


def _data(picture: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; heads are HTML, cells are escaped."""
    head = "".join(f"<th>{text}</th>" for text in heads)
    body = "".join(
        f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'


def number(value: float) -> str:
    """Return three digits of a number, – for what is none."""
    return f"{value:.3g}" if math.isfinite(value) else "–"


def write_file(path: Path, content: bytes) -> None:
    """Write a file so that nobody ever sees half of it.

    Raises:
        UniconError: it cannot be written.
    """
    half = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        half.write_bytes(content)
        half.replace(path)
    except OSError as error:
        half.unlink(missing_ok=True)
        raise UniconError(
            f"cannot write {path}: {error.strerror}; give a writable folder with room to --out"
        ) from error
