"""Results: all runs of a transfer, brought to one value for each platform, as JSON and table."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import yaml

from unicon_base import AnyDict, AnyMapping, UniconError
from unicon_base.located_yaml import read_yaml
from unicon_base.resources import sha256_of, sha256_text
from unicon_core import __version__
from unicon_core.page import plain
from unicon_core.text_table import aligned
from unicon_lab.analysis.run import read_run
from unicon_lab.sweep.figures import apart
from unicon_lab.transfer.rollout import Plan
from unicon_ros.bench.report import machine

SCHEMA = "unicon.transfer/1"

_TABLES: AnyDict = read_yaml(Path(__file__).with_suffix(".yaml")).value
OUTCOMES: dict[str, str] = _TABLES["outcomes"]
"""What may become of a run, in words, the worst first."""

NOT_RUN = ("missing", "refused")
"""Outcomes that are the same with every seed."""

COMMANDED = 0.1
"""Way in [m] from which on a share of it means something."""


class Results:
    """All runs so far.

    Args:
        plan: of the transfer.
        folder: that the runs' files are in.
    """

    def __init__(self, plan: Plan, folder: Path) -> None:
        self.plan, self.folder = plan, folder
        self.runs: dict[str, list[AnyDict]] = {name: [] for name in plan.platforms}
        self.interrupted = False

    @property
    def first(self) -> str:
        """The platform that the others are compared with: the first that could be run."""
        for name, runs in self.runs.items():
            if not runs or runs[0]["outcome"] not in NOT_RUN:
                return name
        return next(iter(self.runs))

    def hopeless(self, platform: str) -> bool:
        """Return whether another seed would change nothing."""
        return any(run["outcome"] in NOT_RUN for run in self.runs[platform])

    def add(self, platform: str, run: AnyDict) -> None:
        """Take a run, and compare it with that of the first platform with the same seed."""
        self.runs[platform].append(run)
        if run["outcome"] != "ran":
            return
        if run["finite_rows"] < run["kept_rows"]:  # nothing that was commanded came of it
            when = run["finite_rows"] * run["period_s"]
            run["faults"].append(f"a measured state is not a number from {when:.2f} s on")
        simulated = run["duration_s"]
        run["wall_per_simulated_s"] = run["wall_s"] / simulated if simulated else None
        if platform == self.first:
            return
        other = next((r for r in self.runs[self.first] if r["seed"] == run["seed"]), None)
        if other is None or other["outcome"] != "ran":
            run["compared"] = {"why_not": f"no run of {self.first} with seed {run['seed']}"}
            return
        ends = [(r["finite_rows"] - 1) * r["period_s"] for r in (other, run)]
        files = [self.folder / r["file"] for r in (other, run)]
        try:
            run["compared"] = apart(*(read_run(f, (0.0, end)) for f, end in zip(files, ends)))
        except UniconError as error:
            run["compared"] = {"why_not": str(error).replace(f"{self.folder}/", "")}

    def to_json(self) -> AnyDict:
        """Return all as plain values; what is not a finite number is null."""
        document = self.plan.document
        ran = [run for runs in self.runs.values() for run in runs if run["outcome"] == "ran"]
        told = ran[0] if ran else {}
        commanded = max((run["commanded_m"] or 0.0 for run in ran), default=0.0)
        values = {
            "schema": SCHEMA,
            "unicon_ros": __version__,
            "machine": machine(),
            "workflow": {
                "name": document.name,
                "description": str(document.values.get("description", "")),
                "file": str(document.path),
                "sha256": sha256_of(document.path),
                "sha256_effective": sha256_text(yaml.safe_dump(document.values)),
                "overrides": list(self.plan.overrides),
            },
            "robot": told.get("robot"),
            "period_s": told.get("period_s"),
            "policies": told.get("policies", {}),
            "first": self.first,
            "seeds": list(self.plan.seeds),
            "duration_s": self.plan.longest,
            "commanded_m": commanded,
            "interrupted": self.interrupted,
            "notes": list(self.plan.notes),
            "platforms": [self._platform(name, commanded) for name in self._shown()],
        }
        return dict(plain(values))

    def _shown(self) -> list[str]:
        """Return the platforms that have a row; of those nobody named, those installed."""
        return [
            name
            for name, runs in self.runs.items()
            if self.plan.asked or not any(run["outcome"] == "missing" for run in runs)
        ]

    def left_out(self) -> list[str]:
        """Return the platforms that have no row: nobody named them, and they are not installed."""
        shown = self._shown()
        return [name for name in self.runs if name not in shown]

    def _platform(self, name: str, commanded: float) -> AnyDict:
        runs = self.runs[name]
        ran = [run for run in runs if run["outcome"] == "ran"]
        for run in ran:
            share = run["distance_m"] is not None and commanded >= COMMANDED
            run["distance_share"] = run["distance_m"] / commanded if share else None
        figures = (
            *("distance_m", "distance_share", "speed_error", "turn_error", "energy_j", "tilt_deg"),
            *("wall_per_simulated_s", "startup_s"),
        )
        compared = [run.get("compared", {}) for run in ran]
        outcomes = [_outcome(run) for run in runs]
        worst = next((word for word in OUTCOMES if word in outcomes), "interrupted")
        return {
            "platform": name,
            "outcome": worst,
            "runs_done": len(ran),
            "runs_asked": len(self.plan.seeds),
            "falls": outcomes.count("fell") + sum(_fell(r) for r in ran if r["faults"]),
            "figures": {key: spread(run[key] for run in ran) for key in figures}
            | {
                key: spread(each.get(key) for each in compared)
                for key in ("mse", "unfolded_mse", "shift_s")
            },
            "troubles": _troubles(runs),
            "runs": runs,
        }


def _outcome(run: AnyDict) -> str:
    if run["outcome"] != "ran":
        return str(run["outcome"])
    return "fault" if run["faults"] else "fell" if _fell(run) else "ran"


def _fell(run: AnyDict) -> bool:
    return bool(run["fell"] or run["fall_s"] is not None)


def _troubles(runs: list[AnyDict]) -> list[str]:
    """Return what went wrong, each thing once with the seeds that it happened with."""
    seeds: dict[str, list[str]] = {}
    for run in runs:
        said = [run["text"]] if run["outcome"] != "ran" else list(run["faults"])
        if run["outcome"] == "ran" and run["fall_s"] is not None:
            said.append(f"fell at {run['fall_s']:.2f} s")
        why_not = run.get("compared", {}).get("why_not")
        said += [f"not compared: {why_not}"] if why_not else []
        for text in said:
            seeds.setdefault(text, []).append(str(run["seed"]))
    if runs and runs[0]["outcome"] in NOT_RUN:
        return list(seeds)
    return [f"seed {', '.join(which)}: {text}" for text, which in seeds.items()]


def spread(values: Iterable[float | None]) -> dict[str, float | int | None]:
    """Return mean and standard deviation (n − 1) of what is there, and of how many.

    The deviation of one value, and both of none, are None.
    """
    there = [value for value in values if value is not None and math.isfinite(value)]
    return {
        "mean": float(np.mean(there)) if there else None,
        "std": float(np.std(there, ddof=1)) if len(there) > 1 else None,
        "runs": len(there),
    }


COLUMNS: dict[str, list[str]] = _TABLES["columns"]
BESIDE: dict[str, str] = _TABLES["beside"]
"""Heading and meaning of the columns beside those of `COLUMNS`."""
"""Figure to heading, unit and meaning."""

FACTORS = {"distance_share": 100.0}


def heads(form: str = " [{}]") -> list[str]:
    """Return the headings of all columns, with their units in a form."""
    figures = [f"{name}{form.format(unit)}" for name, unit, _ in COLUMNS.values()]
    return ["platform", "runs", *figures, "falls", "outcome"]


def row(platform: AnyMapping) -> list[str]:
    """Return the cells of a platform."""
    done = platform["runs_done"]
    return [
        platform["platform"],
        f"{done}/{platform['runs_asked']}",
        *(cell(platform["figures"][key], FACTORS.get(key, 1.0)) for key in COLUMNS),
        str(platform["falls"]) if done else "–",
        OUTCOMES[platform["outcome"]],
    ]


def cell(figure: AnyMapping, factor: float = 1.0) -> str:
    """Return mean ± standard deviation, – where there is nothing."""
    mean, std = figure["mean"], figure["std"]
    if mean is None:
        return "–"
    text = _number(factor * mean)
    return text if std is None else f"{text} ± {_number(factor * std, 2)}"


def _number(value: float, digits: int = 3) -> str:
    if value == 0.0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"


def table(result: AnyMapping) -> str:
    """Return all rows, what went wrong, and what was decided."""
    rows = [heads(), *(row(each) for each in result["platforms"])]
    workflow, first = result["workflow"], result["first"]
    lines = [f"{workflow['name']} on {result['robot'] or 'no robot'}, compared with {first}", ""]
    lines += aligned(rows, right=range(1, len(rows[0]) - 1))
    told = [f"{p['platform']}: {text}" for p in result["platforms"] for text in p["troubles"]]
    notes = list(result["notes"])
    if len(result["seeds"]) > 1:
        notes.append("± is the standard deviation over seeds (n − 1).")
    if result["interrupted"]:
        notes.append("It was interrupted: what was done until then is shown.")
    for more in (told, notes):
        lines += ["", *more] if more else []
    return "\n".join(lines)
