"""Registry: blocks, platforms and faces by name, for the workflow builder and the tables.

What comes with unicon is listed by its packages; third parties register through entry points in the
groups `unicon.blocks`, `unicon.platforms` and `unicon.faces` (of robots that are emulated, by
`transport.protocol`). A factory is imported when it is
asked for, never before: `unicon --help` loads no simulator.

A workflow may also name a `module:function` that is not registered. Its module is imported, as a
launch file's would be, but the function is called only where it says that it makes what is asked
for: `os:system` says no such thing and is refused.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib import import_module
from typing import Annotated, Any, TypeAlias, get_args, get_origin

from unicon_base import MissingDependencyError, UniconError, alternatives
from unicon_base.packages import registered
from unicon_base.schema.records import option_hints
from unicon_core.flow.block import Access, Block, Bundle, Tick
from unicon_core.platforms.platform import Facts

Factory: TypeAlias = Callable[..., Any]

OURS = ("blocks", "platforms")
"""Kinds of which the core has some."""


@lru_cache(maxsize=4)
def known(kind: str) -> Mapping[str, str]:
    """Return name to `module:attribute` of a kind: `blocks`, `platforms` or `faces`."""
    ours: dict[str, str] = {}
    if kind in OURS:
        ours = import_module(f"unicon_core.{kind}").BUILTIN
    return {name: entry.value for name, entry in registered(kind).items()} | ours


def find_factory(kind: str, name: str, error: type[UniconError]) -> Factory:
    """Import the factory of a name, or of a `module:attribute` target.

    Raises:
        error: no such name, or the target does not exist.
        MissingDependencyError: it needs a package that is not installed.
    """
    targets, what = known(kind), f"{kind.rstrip('s')} {name!r}"
    if name not in targets and ":" not in name:
        names = alternatives(name, targets)
        raise error(f"unknown {what}; {names}; or give your own as module:function")
    if name in targets:
        return import_target(targets[name], what, error)
    factory = import_target(name, what, error)
    if not _FACTORIES[kind](factory):
        raise error(
            f"{what} does not say that it makes one, so it is not called; annotate {_SAY[kind]}, "
            f"or register it in the entry point group unicon.{kind}"
        )
    return factory


def is_block_factory(factory: Factory) -> bool:
    """Return whether a callable says that it makes blocks.

    It has a parameter `Reads`, `Writes`, `Amends` or a `Bundle`, or returns a `Tick`, a `Block` or
    a class whose objects say what they read, write or amend.
    """
    hints = option_hints(factory)
    made = hints.get("return")
    if made == Tick or (inspect.isclass(made) and issubclass(made, Block)):
        return True
    if inspect.isclass(made) and any(hasattr(made, name) for name in ("reads", "writes", "amends")):
        return True
    return any(states_in(hints))


def is_platform_factory(factory: Factory) -> bool:
    """Return whether a callable says that it makes platforms.

    It returns a `Platform` or a class with the methods of one, is such a class, or declares facts.
    """
    declared = isinstance(getattr(factory, "facts", None), Facts)
    return declared or _makes(factory, "recv", "send", "close")


def is_face_factory(factory: Factory) -> bool:
    """Return whether a callable says that it makes faces: it returns a class with their methods."""
    return _makes(factory, "tell", "hear", "close")


def _makes(factory: Factory, *methods: str) -> bool:
    made = product_of(factory)
    return inspect.isclass(made) and all(callable(getattr(made, m, None)) for m in methods)


def product_of(factory: Factory) -> Any:
    """Return what a factory says that it returns, None if it does not; a class makes itself."""
    return factory if inspect.isclass(factory) else option_hints(factory).get("return")


def states_in(hints: Mapping[str, Any]) -> tuple[dict[str, str], dict[str, type[Bundle]]]:
    """Return the parameters that are states, with their mode, and those that are bundles.

    Args:
        hints: parameter to annotation.
    """
    access: dict[str, str] = {}
    bundles: dict[str, type[Bundle]] = {}
    for name, hint in hints.items():
        origin = get_origin(hint)
        if origin is None and inspect.isclass(hint) and issubclass(hint, Bundle):
            bundles[name] = hint
        for mark in get_args(hint)[1:] if origin is Annotated else ():
            if isinstance(mark, Access):
                access[name] = mark.mode
    return access, bundles


_FACTORIES: dict[str, Callable[[Factory], bool]] = {
    "blocks": is_block_factory,
    "platforms": is_platform_factory,
    "faces": is_face_factory,
}
_SAY = {
    "blocks": "its states (Reads, Writes, Amends) or what it returns (-> Tick), all of "
    "unicon_core.flow",
    "platforms": "what it returns (-> Platform of unicon_core.platforms.platform, or a class with "
    "recv, send and close)",
    "faces": "what it returns (-> Endpoint of unicon_hardware.endpoint, or a class with tell, hear "
    "and close)",
}


def import_target(target: str, what: str, error: type[UniconError]) -> Factory:
    """Import `module:attribute`.

    Raises:
        error: the module or the attribute does not exist.
        MissingDependencyError: an import inside the module fails.
    """
    module_name, _, attribute = target.partition(":")
    if not all(map(str.isidentifier, (*module_name.split("."), attribute))):
        raise error(f"{what}: {target!r} is not module:function, as in my_blocks:wave")
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as missing:
        if missing.name and not module_name.startswith(missing.name):
            install = f"pip install {missing.name}"
            raise MissingDependencyError(what, missing.name, install) from missing
        raise error(
            f"{what}: no module {module_name!r}; correct the name or add its folder to PYTHONPATH"
        ) from missing
    except Exception as broken:  # whatever the module's own lines raise
        reason = " ".join(f"{type(broken).__name__}: {broken}".split())[:200]
        raise error(f"{what}: importing {module_name!r} raised {reason}; mend it") from broken
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
