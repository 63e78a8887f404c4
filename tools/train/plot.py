"""Draw the training curve of README.md: `python plot.py runs/go2_velocity/log.jsonl`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

PANELS = (
    ("error_lin", "speed error [m/s]"),
    ("error_ang", "yaw rate error [rad/s]"),
    ("swing_time", "swing time [s]"),
    ("fall_rate", "falls per robot and minute"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("curve.png"))
    args = parser.parse_args()
    rows = [json.loads(line) for line in args.log.read_text().splitlines()]
    figure, axes = plt.subplots(1, len(PANELS), figsize=(12, 2.6), dpi=80, layout="constrained")
    for axis, (key, title) in zip(axes, PANELS):
        values = np.array([row[key] for row in rows])
        if key == "fall_rate":
            values = values * 3000.0
        window = min(15, len(values))
        smooth = np.convolve(values, np.ones(window) / window, mode="valid")
        axis.plot(np.arange(len(smooth)) + window - 1, smooth, color="#1f5f8b")
        axis.set(title=title, xlabel="iteration", ylim=(0, None))
        axis.grid(alpha=0.3)
    figure.savefig(args.out)


if __name__ == "__main__":
    main()
