"""Judges what was measured of a fault beside what is wanted, and says it in words."""

from __future__ import annotations

from faults.case import AS_THEY_ARE, Measured, Wants


def judge(wants: Wants, got: Measured) -> list[str]:
    """Return what is not as wanted, each in words; empty where all is."""
    missed = []

    def ask(holds: bool, words: str) -> None:
        if not holds:
            missed.append(words)

    def within(value: float | None, bar: float | None, what: str) -> None:
        if bar is not None:
            said = "never" if value is None else f"after {value:.0f} ms"
            ask(value is not None and value <= bar, f"{what} {said}, wanted within {bar:.0f} ms")

    if wants.most is not None:
        ask(got.commands <= wants.most, f"{got.commands} commands, wanted at most {wants.most}")
    ask(got.commands >= wants.least, f"{got.commands} commands, wanted at least {wants.least}")
    ask(got.wild == 0, f"{got.wild} commands not finite or outside of the limits")
    missed += got.beyond if wants.most is not None else []
    if wants.closed:
        ask(got.ms is not None, "never damped")
        if got.ms is not None:
            within(got.ms, wants.ms, "damped")
    within(got.ended_ms, wants.ended_ms, "ended")
    within(got.zero_ms, wants.zero_ms, "velocity command zero")
    within(got.stands_ms, wants.stands_ms, "stood")
    if wants.status:
        either = " or ".join(map(str, wants.status))
        ask(got.status in wants.status, f"status {got.status}, wanted {either}")
    ask(wants.reason in got.reason, f"reason {got.reason!r} lacks {wants.reason!r}")
    ask(not wants.report or "report" in got.disk, "no report")
    if wants.report and wants.status == (3,) and wants.lost_s is None:
        ask(got.lost_s is not None, "no record of the fault that can be read")
    for file in wants.files:
        ask(file in got.disk, f"no {file}")
    if wants.gap_ms is not None:
        ask(got.gap_ms <= wants.gap_ms, f"{got.gap_ms:.0f} ms between two commands")
    ask(got.overruns >= wants.overruns, f"{got.overruns} overruns, wanted {wants.overruns}")
    ask(got.refused >= wants.refused, f"{got.refused} refused, wanted at least {wants.refused}")
    if wants.gains is not None:
        ask(got.changed == 0, f"{got.changed} commands were changed")
        same = all(abs(have - want) < 1e-3 for have, want in zip(got.gains, wants.gains))
        ask(same, "gains times {:.3g}, {:.3g}".format(*got.gains))
    if wants.speed is not None:
        fast = any(value > bar + 1e-5 for value, bar in zip(got.speed, wants.speed))
        ask(not fast, "velocity command {:.3g}, {:.3g}, {:.3g}".format(*got.speed))
    if wants.lost_s is not None:
        said = "no recording" if got.lost_s is None else f"recording lacks {got.lost_s:.1f} s"
        ask(got.lost_s is not None and got.lost_s <= wants.lost_s, said)
    return missed


def reaction(wants: Wants, got: Measured, by_topic: bool = False) -> str:
    """Return in words what a run did about a fault, of what is wanted of it.

    Args:
        by_topic: commands are those that a robot behind topics got.
    """
    parts = []
    if wants.zero_ms is not None:
        never = "velocity command never 0"
        parts.append(never if got.zero_ms is None else f"velocity 0 after {got.zero_ms:.0f} ms")
    if wants.stands_ms is not None and got.stands_ms is not None:
        parts.append(f"stands after {got.stands_ms:.0f} ms")
    if wants.gains is not None:
        scaled = "" if wants.gains == AS_THEY_ARE else " but for the gains"
        parts.append(f"{got.commands} commands as ever{scaled}")
    if wants.speed is not None:
        parts.append("velocity {:.3g}, {:.3g}, {:.3g}".format(*got.speed))
    if wants.gap_ms is not None:
        parts.append(f"at most {got.gap_ms:.0f} ms between two commands")
    if wants.overruns:
        parts.append(f"{got.overruns} overruns told")
    if wants.lost_s is not None and got.lost_s is not None:
        parts.append(f"recording lacks {got.lost_s:.1f} s")
    if wants.refused:
        parts.append(f"{got.refused} messages refused")
    if by_topic and not got.commands:
        parts.append("no command came")
    elif wants.closed and wants.most is not None:
        what = "last command" if by_topic else "damped"
        parts.insert(0, "never damped" if got.ms is None else f"{what} after {got.ms:.1f} ms")
    elif not parts:
        parts.append("goes on" if got.commands else "nothing was sent")
    return ", ".join(parts)
