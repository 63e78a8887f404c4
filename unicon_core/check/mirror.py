"""Which joints are each other's mirror image, told from their names, for checks of symmetry."""

from __future__ import annotations

import re
from collections.abc import Sequence

__all__ = ["mirror_pairs"]

# Unitree, Fourier, AgiBot, Booster (left_…), quadrupeds (FL_…), short forms (l_…, …_l).
_SIDES = (
    (r"(^|_)left(?=_|$)", r"\g<1>right"),
    (r"(^|_)Left(?=_|$)", r"\g<1>Right"),
    (r"(^|_)LEFT(?=_|$)", r"\g<1>RIGHT"),
    (r"(^|_)([FRHM])L(?=_|$)", r"\g<1>\g<2>R"),
    (r"(^|_)L([FHMR])(?=_|$)", r"\g<1>R\g<2>"),
    (r"(^|_)l(?=_|$)", r"\g<1>r"),
    (r"(^|_)L(?=_|$)", r"\g<1>R"),
)


def mirror_pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs (left, right) of joints, in the order of the left ones.

    Args:
        names: joint names in any order.
    """
    known = set(names)
    pairs = []
    for name in names:
        for pattern, other in _SIDES:
            right = re.sub(pattern, other, name, count=1)
            if right != name and right in known:
                pairs.append((name, right))
                break
    return pairs
