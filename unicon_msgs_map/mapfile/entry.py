"""Values of a mapping file as `mapfile` asks for them: typed, and every mistake with its line."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

from unicon_core.errors import UniconError, alternatives
from unicon_core.located_yaml import Located, Where


@dataclass(frozen=True)
class Entry:
    """A YAML value and where it stands.

    Attributes:
        value: scalar, list or mapping.
        document: the file.
        at: path of keys in it.
    """

    value: Any
    document: Located
    at: Where = ()

    @property
    def where(self) -> str:
        """`file:line`."""
        return self.document.where(self.at)

    def fail(self, message: str) -> UniconError:
        """Return the error to raise about this value."""
        return self.document.error(self.at, message)

    def mapping(self, what: str, known: tuple[str, ...] = ()) -> dict[str, Entry]:
        """Return the value as a mapping whose keys are all known (any, where none is listed)."""
        if not isinstance(self.value, dict):
            raise self.fail(f"{what} must be a mapping of names to values, not {self.value!r}")
        entries = {k: Entry(v, self.document, (*self.at, k)) for k, v in self.value.items()}
        for key, entry in entries.items():
            if not isinstance(key, str):
                raise entry.fail(f"{what}: key {key!r} is not a word; write a name or a path")
            if known and key not in known:
                raise entry.fail(f"{what} has no key {key!r}; {alternatives(key, known)}")
        return entries

    def items(self, what: str) -> list[Entry]:
        """Return the value as a list."""
        if not isinstance(self.value, list):
            raise self.fail(f"{what} must be a list ('- …' lines), not {self.value!r}")
        return [Entry(v, self.document, (*self.at, i)) for i, v in enumerate(self.value)]

    def text(self, what: str) -> str:
        """Return the value as a non-empty string."""
        if not isinstance(self.value, str) or not self.value:
            raise self.fail(f"{what} must be text, not {self.value!r}")
        return self.value

    def one_of(self, what: str, choices: tuple[str, ...]) -> str:
        """Return the value as one of some words."""
        if self.value not in choices:
            raise self.fail(f"{what} is {self.value!r}; choose one of {', '.join(choices)}")
        return str(self.value)

    def number(self, what: str, *, positive: bool = False, highest: float = 1e30) -> float:
        """Return the value as a number of a size up to `highest`; infinities never are."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
            raise self.fail(f"{what} must be a number, not {value!r}")
        if positive and not value > 0:
            raise self.fail(f"{what} must be above 0, not {value}")
        if not abs(value) <= highest:
            raise self.fail(f"{what} must be at most {highest:g}, not {value!r:.20}")
        return float(value)

    def boolean(self, what: str) -> bool:
        """Return the value as true or false."""
        if not isinstance(self.value, bool):
            raise self.fail(f"{what} must be true or false, not {self.value!r}")
        return self.value
