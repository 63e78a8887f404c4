"""What fills the inputs of a network that is one of several."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

from unicon_core.errors import PolicyError
from unicon_core.policies.hints import listed
from unicon_core.schema.marks import Made, NotEmpty, Write


@dataclass(frozen=True)
class Feed:
    """What fills a part of a network's input: `source[start:stop]`.

    Attributes:
        source: `observation`, or `NAME.output` of an earlier network.
        start, stop: elements; `stop` is None for all.
    """

    source: str
    start: int = 0
    stop: int | None = None

    @classmethod
    def of(cls, text: str) -> Feed:
        """Return what a text such as `observation[0:45]` means.

        Raises:
            PolicyError: it means nothing.
        """
        match = re.fullmatch(r"([^\[\]]+)(?:\[(\d{1,6}):(\d{1,6})\])?", text)
        if match is None:
            raise PolicyError(f"has {text!r}; write observation, observation[0:45] or NAME.output")
        source, start, stop = match.groups()
        if start is None:
            return cls(source)
        if int(start) >= int(stop):
            raise PolicyError(f"has {text!r}, which is empty; the first comes first")
        return cls(source, int(start), int(stop))

    def __str__(self) -> str:
        return self.source if self.stop is None else f"{self.source}[{self.start}:{self.stop}]"


def _feeds(texts: Any) -> tuple[Feed, ...]:
    return tuple(map(Feed.of, listed(texts)))


_FeedText = Annotated[str, Write("observation, observation[0:45] or NAME.output")]
Feeds: TypeAlias = Mapping[
    str, Annotated[tuple[Feed, ...], Made(_feeds, _FeedText | Annotated[list[_FeedText], NotEmpty])]
]
