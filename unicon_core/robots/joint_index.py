"""The one place where joint orders are matched by name, for policies, platforms and models."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import RobotError, alternatives


def joint_index(
    to: Sequence[str], from_: Sequence[str], *, loose: bool = False
) -> NDArray[np.intp]:
    """Return the index that brings an array from one joint order into another.

    `x_from[joint_index(to, from_)]` is in the order of `to`: the result is a `to_from_from_`,
    such as `policy_from_robot = joint_index(policy.joint_names, robot.joint_names)`.

    Args:
        to: the joint names wanted, in their order; a subset of `from_`.
        from_: the joint names at hand, in their order.
        loose: where the exact name is not there, the one is meant that is equal but for a namespace
            (`g1/…`) and the ending `_joint`: models of others.

    Returns:
        Indices into `from_`, shape (len(to),).

    Raises:
        RobotError: a joint of `to` is not in `from_`, or could be two of it; a list names a joint
            twice.
    """
    for which, names in (("wanted", to), ("given", from_)):
        twice = sorted({name for name in names if list(names).count(name) > 1})
        if twice:
            raise RobotError(
                f"joint {twice[0]!r} stands twice in the {which} joint order; name each joint once"
            )
    position = {name: i for i, name in enumerate(from_)}
    alike: dict[str, list[str]] = {}
    for name in from_ if loose else ():
        alike.setdefault(plain_name(name), []).append(name)
    found: list[int] = []
    for name in to:
        fits = [name] if name in position else alike.get(plain_name(name), [])
        if not fits:
            raise RobotError(f"no joint {name!r}; {alternatives(name, from_)}")
        if len(fits) > 1:
            raise RobotError(f"joint {name!r} could be any of {', '.join(fits)}")
        if position[fits[0]] in found:
            raise RobotError(f"joint {name!r} and another one are both {fits[0]!r}")
        found.append(position[fits[0]])
    return np.array(found, dtype=np.intp)


def plain_name(name: str) -> str:
    """Return a joint name without namespace and without the ending `_joint`."""
    return name.rsplit("/", 1)[-1].removesuffix("_joint")
