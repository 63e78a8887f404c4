"""Figures as text, for whatever is shown of robots, policies and checks."""

from __future__ import annotations

from collections.abc import Iterable


def figure(value: float, form: str = "g") -> str:
    """Return a number as text: `?` for one that is not known, and no zero with a minus sign."""
    if value != value:
        return "?"
    text = format(float(value), form)
    return text if text.strip("+-0.%") else format(abs(float(value)), form)


def span(low: float, high: float, dots: str = " … ", form: str = "g") -> str:
    """Return a range as text: as `figure`, with something between its ends."""
    return f"{figure(low, form)}{dots}{figure(high, form)}"


def figures(values: Iterable[float], form: str = "g") -> list[str]:
    """Return figures one by one; see `figure`."""
    return [figure(value, form) for value in values]


def spans(low: Iterable[float], high: Iterable[float], form: str = "g") -> list[str]:
    """Return spans one by one; see `span`."""
    return [span(*ends, form=form) for ends in zip(low, high)]
