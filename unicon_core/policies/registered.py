"""Policies that other packages register through the entry point group `unicon.policies`.

The entry point's value is a module attribute: a path (text or `Path`) of a policy's folder or file,
or a function without parameters that returns one. It is imported when the policy is asked for.
"""

from __future__ import annotations

from pathlib import Path

from unicon_core.errors import PolicyError
from unicon_core.registered import path_of, registered


def registered_policy(name: str) -> Path:
    """Return the folder or file of a registered policy.

    Raises:
        PolicyError: its module cannot be imported, or it gives no path that exists.
    """
    entry = registered("policies")[name]
    path = path_of(entry, f"policy {name!r}", PolicyError)
    if path is None:
        raise PolicyError(f"policy {name!r} (entry point {entry.value}) returned no path")
    return path
