"""What a platform in a child can do for its parent besides a tick: the one table of both sides.

A call goes through the pipe, and what the method returns or raises comes back. None is called once
commands are sent but those of simulators. A new ability needs its line here and nothing else.
"""

from __future__ import annotations

from typing import Any

from unicon_core.platforms.platform import (
    CountsArrivals,
    Prepares,
    Pushable,
    ReportsVariant,
    RequiresStates,
    Resettable,
    SeesCommanders,
)

ABILITIES: dict[str, Any] = {
    "reset": Resettable,
    "push": Pushable,
    "require": RequiresStates,
    "variant": ReportsVariant,
    "commanders": SeesCommanders,
    "prepare": Prepares,
    "arrivals": CountsArrivals,
}
"""Method to protocol."""
