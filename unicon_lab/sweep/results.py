"""Results: all rows of a sweep's folder, for gates, reports and comparisons; chance in shares."""

from __future__ import annotations

import hashlib
import json
import math
import shlex
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyDict, UniconError
from unicon_lab.sweep.figures import COLUMNS
from unicon_lab.sweep.folder import (
    SETTINGS,
    SWEEP,
    VARIED,
    read_shards,
    read_sweep_json,
    require_pyarrow,
)
from unicon_lab.sweep.sweep_file import SCHEMA, SHARES, Gate

Z95 = 1.959963984540054
"""Of the normal distribution, for 95 %."""


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share (Wilson 1927); (0, 1) of nothing.

    (p + z²/2n ± z √(p(1-p)/n + z²/4n²)) / (1 + z²/n); right for few hits too, where p ± z σ is not.

    Args:
        hits: how often it happened.
        count: of how many.
    """
    if not count:
        return 0.0, 1.0
    p, z = hits / count, Z95
    middle = p + z * z / (2 * count)
    half = z * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
    whole = 1 + z * z / count
    low = 0.0 if not hits else (middle - half) / whole
    return low, 1.0 if hits == count else (middle + half) / whole


FAILED = ("refused", "crashed")
"""Outcomes of rows without a result."""


class Results:
    """The rows in the shards of a folder, in order.

    Args:
        path: of the folder.

    Attributes:
        path: the same.
        said: what `sweep.json` says.
        identity: of the sweep.

    Raises:
        UniconError: it is not a sweep's folder.
    """

    def __init__(self, path: Path) -> None:
        require_pyarrow()
        said = read_sweep_json(path)
        if said is None:
            raise UniconError(f"{path} has no {SWEEP}; give the folder of a sweep")
        if said["identity"].get("schema") != SCHEMA:
            raise UniconError(f"{path / SWEEP} is not of {SCHEMA}; give the folder of a sweep")
        self.path, self.said, self.identity = path, said, said["identity"]
        columns = read_shards(path, said["sha256"])
        order: dict[int, int] = {}  # a row in two shards is the same row
        for place, index in enumerate(columns.get("row", ())):
            order.setdefault(index, place)
        places = [order[index] for index in sorted(order)]
        self._columns = {
            name: [values[place] for place in places] for name, values in columns.items()
        }
        self.rows: list[int] = sorted(order)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def parameters(self) -> list[str]:
        """Paths of what was varied."""
        return [str(path) for path, _ in self.identity["vary"]]

    @property
    def asked(self) -> int:
        """Rows that the sweep has in all."""
        return int(self.identity["points"]) * int(self.identity["repeat"])

    @property
    def lacking(self) -> int:
        """Rows that were not run yet."""
        return self.asked - len(self.rows)

    @cached_property
    def good(self) -> list[int]:
        """Places of the rows that have a result."""
        outcomes = self._columns.get("outcome", [])
        return [place for place, word in enumerate(outcomes) if word not in FAILED]

    @property
    def failed(self) -> int:
        """Rows that were refused, or whose worker crashed."""
        return len(self.rows) - len(self.good)

    def every(self, name: str) -> list[Any]:
        """Return a column of all rows."""
        return self._columns.get(name, [])

    def column(self, name: str) -> list[Any]:
        """Return a column of the rows that have a result."""
        values = self.every(name)
        return [values[place] for place in self.good]

    def varied(self, path: str) -> list[Any]:
        """Return what a parameter was in the rows that have a result."""
        return self.column(VARIED + path)

    def row(self, place: int) -> AnyDict:
        """Return one row, by its place among all."""
        return {name: values[place] for name, values in self._columns.items()}

    def settings(self, place: int) -> list[str]:
        """Return the texts of `--set` of one row, by its place among all."""
        return [str(text) for text in json.loads(self.every(SETTINGS)[place])]

    def command(self, place: int) -> str:
        """Return the command that runs a row again, bit-exact, by its place among all.

        Its report has the row's `sha256_commands`: an early stop ends there, too; a fault comes by
        itself.
        """
        row = self.row(place)
        duration = row["duration_s"] if row["outcome"] == "fell" else self.identity["duration_s"]
        words = ["unicon", "run", str(self.said.get("run") or self.identity["workflow"])]
        for setting in self.settings(place):
            words += ["--set", setting]
        return shlex.join([*words, "--speed", "max", "--duration", f"{duration:.9g}"])

    def mixed(self) -> bool:
        """Return whether rows that differ in nothing but the scene ran on other files."""
        outside = [path for path in self.parameters if not path.startswith("scene.")]
        seen: dict[tuple[Any, ...], Any] = {}
        columns = [self.varied(path) for path in outside]
        keys = zip(*columns) if columns else iter([()] * len(self.good))
        return any(
            seen.setdefault(key, program) != program
            for key, program in zip(keys, self.column("program"))
        )

    def compared(self, gate: Gate) -> list[tuple[Any, float]]:
        """Return each value of a gate's parameter, or None, and what is compared; worst first.

        Raises:
            UniconError: the parameter was not varied.
        """
        places = {"": list(range(len(self.good)))}
        shown = {"": None}
        if gate.each:
            gate.check(self.parameters)
            places, shown = {}, {}
            for place, value in enumerate(self.varied(gate.each)):
                places.setdefault(repr(value), []).append(place)
                shown[repr(value)] = value
        found = [(shown[key], self._statistic(gate, rows)) for key, rows in places.items()]
        upwards = gate.sign.startswith(">")
        return sorted(found, key=lambda x: (x[1] == x[1], x[1] if upwards else -x[1]))

    def _statistic(self, gate: Gate, places: list[int]) -> float:
        """What is compared of some rows with a result; NaN where nothing can be."""
        column = self.column(SHARES.get(gate.word, gate.word))
        there = [column[place] for place in places if column[place] is not None]
        if not there:
            return float("nan")
        if gate.word in SHARES:
            hits = sum(map(bool, there))
            low, high = wilson(hits, len(there))
            return {"rate": hits / len(there), "lower": low, "upper": high}[gate.statistic]
        values = np.array(there, np.float64)
        if gate.statistic.startswith("p"):
            return float(np.percentile(values, int(gate.statistic[1:])))
        return float(getattr(np, gate.statistic)(values))

    def holds(self, gate: Gate) -> bool:
        """Return whether a gate holds; a rollout without a result breaks every gate."""
        found = self.compared(gate)
        complete = not self.lacking and not self.failed
        return complete and bool(found) and all(gate.met(value) for _, value in found)

    def verdict(self, gate: Gate) -> str:
        """Return the condition, what was found where it is worst, and whether it holds."""
        if self.lacking:
            return f"gate {gate.text}: not known yet"
        verdict = "holds" if self.holds(gate) else "BROKEN"
        where, value = next(iter(self.compared(gate)), (None, float("nan")))
        at = f" at {where}" if gate.each else ""
        return f"gate {gate.text}: {value:.4g}{at}, {verdict}"

    def worst(self, count: int) -> list[int]:
        """Return the places of the worst rows, the worst first.

        First those without a result, then falls by when they came, then other faults, then the
        largest error of speed.
        """

        def order(place: int) -> tuple[float, ...]:
            row = self.row(place)
            fall, error = row["fall_s"], row["speed_error"]
            return (
                row["outcome"] not in FAILED,
                not row["fell"],
                math.inf if fall is None else fall,
                not row["fault"],
                -(error or 0.0),
            )

        return sorted(range(len(self)), key=order)[:count]

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of all rows, sorted: the same however they were computed."""
        names = ["row", *(VARIED + path for path in self.parameters), *COLUMNS]
        digest = hashlib.sha256()
        columns = [self.every(name) for name in names]
        for values in zip(*columns):
            digest.update((json.dumps(values) + "\n").encode())
        return digest.hexdigest()
