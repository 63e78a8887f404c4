"""Registry: blocks, platforms and policies by name, for the workflow builder and the tables.

What comes with unicon is listed by its packages; third parties register through entry points in the
groups `unicon.blocks`, `unicon.platforms` and `unicon.policies`. A factory is imported when it is
asked for, never before: `unicon --help` loads no simulator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, TypeAlias

from unicon_core.errors import MissingDependencyError, UniconError, alternatives

__all__ = ["Factory", "find_factory", "import_target", "known"]

Factory: TypeAlias = Callable[..., Any]

_BUILTIN = {
    "blocks": ("unicon_core.blocks", "BUILTIN"),
    "platforms": ("unicon_core.platforms", "BUILTIN"),
}


@lru_cache(maxsize=4)
def known(kind: str) -> Mapping[str, str]:
    """Return name to `module:attribute` of a kind: `blocks`, `platforms` or `policies`."""
    targets: dict[str, str] = {}
    if kind in _BUILTIN:
        module, attribute = _BUILTIN[kind]
        targets.update(getattr(import_module(module), attribute))
    for entry in entry_points(group=f"unicon.{kind}"):
        targets.setdefault(entry.name, entry.value)
    return targets


def find_factory(kind: str, name: str, error: type[UniconError]) -> Factory:
    """Import the factory of a name, or of a `module:attribute` target.

    Raises:
        error: no such name, or the target does not exist.
        MissingDependencyError: it needs a package that is not installed.
    """
    targets = known(kind)
    if name not in targets and ":" not in name:
        singular = kind.rstrip("s")
        raise error(
            f"unknown {singular} {name!r}; {alternatives(name, targets)}; "
            f"or give your own as module:function"
        )
    return import_target(targets.get(name, name), f"{kind.rstrip('s')} {name!r}", error)


def import_target(target: str, what: str, error: type[UniconError]) -> Factory:
    """Import `module:attribute`.

    Raises:
        error: the module or the attribute does not exist.
        MissingDependencyError: an import inside the module fails.
    """
    module_name, _, attribute = target.partition(":")
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as missing:
        if missing.name and not module_name.startswith(missing.name):
            install = f"pip install {missing.name}"
            raise MissingDependencyError(what, missing.name, install) from missing
        raise error(
            f"{what}: no module {module_name!r}; correct the name or add its folder to PYTHONPATH"
        ) from missing
    try:
        factory = getattr(module, attribute)
    except AttributeError:
        names = [name for name in dir(module) if not name.startswith("_")]
        raise error(
            f"{what}: module {module_name!r} has no {attribute!r}; {alternatives(attribute, names)}"
        ) from None
    if not callable(factory):
        raise error(f"{what}: {target} is a {type(factory).__name__}, not a function")
    return factory  # type: ignore[no-any-return]
