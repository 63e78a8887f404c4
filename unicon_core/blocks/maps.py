"""Blocks `copy` and `linear_map`: one state from another; the compiler fuses adjacent ones."""

from __future__ import annotations

from collections.abc import Sequence

from unicon_base.arrays import Array
from unicon_base.errors import StateError, alternatives
from unicon_core.flow.block import LinearMap
from unicon_core.states import States


def copy(
    *,
    states: States,
    source: str,
    target: str,
    index: Sequence[int | str] | None = None,
) -> LinearMap:
    """Copy a state, or some of its elements, into another state.

    Args:
        source: label of the state that is read, shape (..., m).
        target: label of the state that is written, shape (..., k).
        index: k elements of the source's last axis, by number or by element name; None for all.

    Raises:
        StateError: no such state or element, or the sizes differ.
    """
    return linear_map(
        states=states, source=source, target=target, index=index, scale=None, offset=None
    )


def linear_map(
    *,
    states: States,
    source: str,
    target: str,
    index: Sequence[int | str] | None = None,
    scale: float | Sequence[float] | None = 1.0,
    offset: float | Sequence[float] | None = 0.0,
) -> LinearMap:
    """Write `source[..., index] · scale + offset` into another state.

    Args:
        source: label of the state that is read, shape (..., m).
        target: label of the state that is written, shape (..., k).
        index: k elements of the source's last axis, by number or by element name; None for all.
        scale: one factor, or one for each of the k elements.
        offset: one summand, or one for each of the k elements, in the target's unit.

    Raises:
        StateError: no such state or element, or the sizes differ.
    """
    names = states.spec(source).names
    places = None if index is None else [_place(element, names, source) for element in index]
    read, written = _vector(states, source), _vector(states, target)
    return LinearMap(read, written, places, scale, offset, source, target)


def _vector(states: States, name: str) -> Array:
    """Return a state; a scalar one is one element: a last axis for it makes all states alike."""
    return states[name] if states.spec(name).shape else states[name][..., None]


def _place(element: int | str, names: tuple[str, ...], state: str) -> int:
    if not isinstance(element, str):
        return element
    if element not in names:
        raise StateError(
            f"state {state!r} has no element {element!r}; {alternatives(element, names)}"
        )
    return names.index(element)
