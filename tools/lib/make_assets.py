"""Writes config/assets.yaml from a table of public files: name, file, repository, commit, path, …

.venv/bin/python tools/lib/make_assets.py asset-sources.tsv > config/assets.yaml
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

NETWORKS = (".onnx", ".pt")
PLACED = {
    "a1_description/urdf/a1.urdf": "a1.urdf",
    "motion.pt": "deploy_real/motion.pt",
}
"""Files that lie elsewhere in the assets folder: where robot files name them, or a contract."""
SETS = {"g1": ("g1_29dof", "g1_velocity_mjlab")}
"""Names that stand for several assets."""
HEAD = """\
# Public models and policies, for `unicon assets`: what is fetched from where, and its licence.
# Made by tools/lib/make_assets.py. A file: [number of its source, path there, bytes, SHA-256], and
# its name on a mirror where that is another.
"""


def main() -> None:
    """Print the document."""
    with Path(sys.argv[1]).open(encoding="utf-8", newline="") as table:
        rows = list(csv.DictReader(table, delimiter="\t"))
    print(HEAD)
    for name, members in SETS.items():
        print(f"{name}: [{', '.join(members)}]")
    for name in sorted({row["name"] for row in rows}):
        own = [row for row in rows if row["name"] == name]
        sources = list(dict.fromkeys((r["repository"], r["commit"], r["licence"]) for r in own))
        policy = any(row["file"].endswith(NETWORKS) for row in own)
        print(f"\n{name}:\n  kind: {'policy' if policy else 'model'}\n  sources:")
        for repository, commit, licence in sources:
            print(f"  - {{repository: {repository}, commit: {commit}, licence: {licence}}}")
        print("  files:")
        for row in own:
            number = sources.index((row["repository"], row["commit"], row["licence"]))
            facts = f'{number}, "{row["path"]}", {row["bytes"]}, {row["sha256"]}'
            placed = PLACED.get(row["file"], row["file"])
            if placed != row["file"]:
                facts += f', "{row["file"]}"'
            print(f'    "{placed}": [{facts}]')


main()
