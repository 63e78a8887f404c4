"""Policies that other packages register through the entry point group `unicon.policies`.

The entry point's value is a module attribute: a path (text or `Path`) of a policy's folder or file,
or a function without parameters that returns one. It is imported when the policy is asked for.
"""

from __future__ import annotations

import os
from pathlib import Path

from unicon_core.errors import PolicyError
from unicon_core.registered import registered

__all__ = ["registered_policy"]


def registered_policy(name: str) -> Path:
    """Return the folder or file of a registered policy.

    Raises:
        PolicyError: its module cannot be imported, or it gives no path that exists.
    """
    entry = registered("policies")[name]
    label = f"policy {name!r} (entry point {entry.value})"
    try:
        value = entry.load()
        value = value() if callable(value) else value
    except Exception as error:  # whatever another package's code raises
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise PolicyError(f"{label}: {reason}; install its package again") from error
    if not isinstance(value, (str, os.PathLike)):
        raise PolicyError(
            f"{label}: its value is of type {type(value).__name__}; it must be the path of a "
            "folder or file, or a function that returns one"
        )
    path = Path(value)
    if not os.path.exists(path):
        raise PolicyError(f"{label}: no such path {path}; install its package again")
    return path.resolve()
