"""Refuses models that would take for ever, or have figures which are none; for the model loader.

A few lines can ask for 10⁸ bodies, for gigabytes, or for a pipe that nobody fills: repetitions
inside each other, files that include or attach others many times, or themselves. MuJoCo does all
of it, and takes the process with it where its stack or the memory ends.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from contextlib import suppress
from math import prod
from os.path import exists, isdir, isfile
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import ModelError

COPIES = 5_000
"""Elements made by repetition: MuJoCo takes 1 to 3 s for so many, and 4 times that for twice."""
HEAVY = {"composite": 15, "flexcomp": 2}
"""How many elements one point of these costs as much time as."""
ELEMENTS = 20_000
"""Of a model file and all that it includes: a chain of 5,000 links takes 5 s."""
FIGURE = 10_000
"""Rows, columns, pixels, user data: a texture of this width and height takes 300 MB."""
FIGURES = frozenset(("nrow", "ncol", "width", "height", "params", "dim", "actdim", "nsample"))
BYTES = 64 * 2**20
"""Of one file of XML: meshes written into it are some MB."""
DEPTH = 50
"""Of files that include or attach others."""
FOLDERS = 20
"""In which all files are looked for: `meshdir`, `texturedir`, `assetdir`."""

# Cut as MuJoCo's own parser does, so that nothing hides in a comment or in quotes. What has no end
# matches too: nothing is looked at twice.
_TAG = re.compile(
    r"<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<\?.*?(?:\?>|\Z)"
    r"|<(/?)([A-Za-z_][^\s/<>=\"']*)((?:[^<>\"']|\"[^\"]*\"|'[^']*')*)>?",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"(?<![^\s/\"'=])([^\s/\"'=]+)\s*=\s*(\"[^\"]*\"|'[^']*')")

Tag = tuple[str, dict[str, str], bool, bool]
"""Name, attributes, whether it closes an element, whether its element has nothing inside."""


def refuse_endless(path: Path) -> None:
    """Refuse what is too much, in a file and in all that it includes or attaches.

    Called before MuJoCo reads it.

    Raises:
        ModelError: it repeats or includes too much, has too large a figure, or names a device.
    """
    _Reader(path).size(path, ())


def refuse_not_finite(path: Path, model: Any) -> None:
    """Refuse a compiled model with a figure that is NaN or infinite.

    MuJoCo takes it, and a simulation with it starts anew when it is not finite any more.

    Raises:
        ModelError: with the names of such arrays.
    """
    wrong = []
    for owner in (model.opt, model):
        for name in dir(owner):
            value = None if name.startswith("_") else getattr(owner, name)
            if isinstance(value, float | np.ndarray) and not _finite(value):
                wrong.append(name)
    if wrong:
        named = f"{', '.join(wrong[:8])} {'is' if len(wrong) == 1 else 'are'}"
        raise ModelError(f"model {path}: {named} not finite; look for nan and inf in the file")


def _finite(value: float | np.ndarray[Any, Any]) -> bool:
    kind = np.asarray(value).dtype.kind
    return kind != "f" or bool(np.isfinite(value).all())


class _Reader:
    """Reads a model and the models that it attaches.

    Args:
        path: of the model.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._files: dict[Path, list[Tag]] = {}
        self._sizes: dict[Path, float] = {}
        self._count = 0

    def size(self, path: Path, above: tuple[Path, ...]) -> float:
        """Return how many elements a model has once all is repeated.

        Args:
            path: of it.
            above: the models that attach it, the outermost first.
        """
        if path in self._sizes:
            return self._sizes[path]
        tags = list(self._tags(path, path, above))
        folders = self._folders(path, tags)
        models: dict[str | None, float] = {}
        for name, given, closes, _ in tags:
            if closes:
                continue
            self._figures(name, given)
            self._devices(given, folders)
            if name == "model" and "file" in given:
                found = _found(given["file"], folders)
                models[given.get("name")] = sum(self.size(file, (*above, path)) for file in found)
        self._sizes[path] = self._counted(tags, models)
        return self._sizes[path]

    def _folders(self, path: Path, tags: list[Tag]) -> set[Path]:
        folders = {path.parent}
        for name, given, _, _ in tags:
            if name == "compiler":
                folders |= {path.parent / v for key, v in given.items() if key.endswith("dir")}
        if len(folders) > FOLDERS:
            raise self._error(f"it names more than {FOLDERS} folders; leave some out")
        return folders

    def _counted(self, tags: list[Tag], models: dict[str | None, float]) -> float:
        size = sum(models.values())
        copies = 0.0
        times = [1.0]
        most = max(models.values(), default=0.0)
        for name, given, closes, empty in tags:
            if closes:
                times = times[:-1] or [1.0]
                continue
            here = times[-1]
            count = prod(_numbers(given.get("count", "")))
            size += 1.0
            copies += here - 1.0
            if name in HEAVY:
                copies += here * count * HEAVY[name]
            elif name == "attach":
                copies += here * models.get(given.get("model"), most)
            if not empty:
                times.append(here * count if name == "replicate" else here)
        if copies > COPIES:
            raise self._error(
                f"it repeats bodies or geoms more than {COPIES} times (replicate, composite, "
                "flexcomp, attach); give smaller counts"
            )
        if size > ELEMENTS:
            raise self._error(f"it has more than {ELEMENTS} elements; leave some out")
        return size + copies

    def _tags(self, path: Path, main: Path, above: tuple[Path, ...]) -> Iterator[Tag]:
        """Yield the tags of a file, those of what it includes in their place."""
        if path in above or len(above) > DEPTH:
            raise self._error(
                f"{path.name} includes or attaches itself, or stands more than {DEPTH} deep; take "
                "that out"
            )
        for tag in self._read(path):
            self._count += 1
            if self._count > ELEMENTS * 2:  # with those that close
                raise self._error(f"it has more than {ELEMENTS} elements; leave some out")
            yield tag
            name, given, closes, _ = tag
            if name == "include" and not closes and "file" in given:
                for file in _found(given["file"], {main.parent, path.parent}):
                    yield from self._tags(file, main, (*above, path))

    def _read(self, path: Path) -> list[Tag]:
        if path not in self._files:
            try:
                if exists(path) and not isfile(path):
                    raise self._error("it is not a file; name one")
                if path.stat().st_size > BYTES:
                    raise self._error(f"{path.name} has more than {BYTES >> 20} MB; make it less")
                text = path.read_bytes().decode("utf-8", "surrogateescape")
            except OSError:
                text = ""  # MuJoCo says so
            self._files[path] = tags = []
            for found in _TAG.finditer(text):
                if found[2]:
                    empty = found[3].endswith("/")
                    tags.append((found[2], _attributes(found[3]), bool(found[1]), empty))
                if len(tags) > ELEMENTS * 2:
                    break  # `_tags` refuses it
        return self._files[path]

    def _figures(self, name: str, given: dict[str, str]) -> None:
        for key, value in given.items():
            user = name == "size" and key.startswith(("nuser", "nkey"))
            if (key in FIGURES or user) and max(_numbers(value)) > FIGURE:
                raise self._error(
                    f"{key} of {name} is {value[:40]!r}; give at most {FIGURE}, or leave it out"
                )

    def _devices(self, given: dict[str, str], folders: set[Path]) -> None:
        """Refuse pipes and devices, which have no end or never begin."""
        for key, file in given.items():
            for place in _places(file, folders) if key.startswith("file") else ():
                if exists(place) and not (isfile(place) or isdir(place)):
                    raise self._error(f"{key} {file[:60]!r} is a pipe or a device; name a file")

    def _error(self, told: str) -> ModelError:
        return ModelError(f"model {self._path}: {told}")


def _attributes(text: str) -> dict[str, str]:
    """Return name to value; of two with the same name the first, as MuJoCo does."""
    return {key: html.unescape(v[1:-1]) for key, v in reversed(_ATTRIBUTE.findall(text))}


def _places(file: str, folders: set[Path]) -> list[Path]:
    return [folder / file for folder in sorted(folders)]


def _found(file: str, folders: set[Path]) -> list[Path]:
    return [place for place in _places(file, folders) if isfile(place)]


def _numbers(text: str) -> list[float]:
    """Return the numbers of an attribute, each at least 1; what is not a number is left out."""
    numbers = [1.0]
    for word in text.split():
        with suppress(ValueError):
            numbers.append(max(1.0, float(word)))
    return numbers
