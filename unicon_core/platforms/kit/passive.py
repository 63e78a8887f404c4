"""Passive damping: that of a model's joints themselves, beside the damping of the command."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

from unicon_core.errors import PlatformError, alternatives

__all__ = ["Passive", "known_passive"]

Passive: TypeAlias = Literal["keep", "replace"]
"""`keep` it beside the damping of the command, or let that `replace` it."""


def known_passive(word: Passive) -> Passive:
    """Return the word.

    Raises:
        PlatformError: it is another one.
    """
    known = get_args(Passive)
    if word not in known:
        raise PlatformError(f"passive is {word!r}; {alternatives(str(word), known)}")
    return word
