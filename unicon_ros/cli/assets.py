"""`unicon assets`: other people's models and policies, from their public repositories.

unicon assets list                   what there is, its size and licence, what is at hand
unicon assets fetch g1_29dof h1      into the user's cache, or from a mirror: --from DIR or URL
unicon assets path g1_29dof          its folder
unicon assets verify [NAME …]        compares files with the SHA-256 of config/assets.yaml
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_base import UniconError
from unicon_base.resources import assets_roots
from unicon_ros.cli.console import Console, note, print_json, print_table
from unicon_ros.cli.options import EXAMPLES, argument, command, flag, option, several

if TYPE_CHECKING:
    from unicon_core.workflow.document import WorkflowDocument

EVERY = 0.1
"""Of the progress line in [s]."""
HEAD = ("asset", "kind", "MB", "licence", "at hand")
COPYLEFT = ("GPL", "MPL")


def fetch_all(names: Sequence[str], mirror: str | None = None) -> int:
    """Fetch assets, and say what comes from where under which licence."""
    from unicon_core.assets.fetching import fetch
    from unicon_core.assets.manifest import LICENCES, Asset, load_assets, named

    assets = named(names, load_assets())

    def introduce(asset: Asset) -> None:
        places = ", ".join(f"{s.repository}@{s.commit[:8]}" for s in asset.sources)
        print(f"{asset.name}: {len(asset.files)} files, {asset.size / 1e6:.1f} MB of {places}")
        said = f"  licence {asset.licence}"
        if asset.files[0].name.startswith(LICENCES):
            said += f", in its folder {LICENCES.rstrip('/')}"
        if any(word in asset.licence for word in COPYLEFT):
            said += "; who passes it on has duties"
        print(said, flush=True)

    for asset in assets:
        introduce(asset)
        console = Console()
        try:
            got = fetch(
                asset,
                mirror=mirror,
                progress=partial(_show, console, asset.name),
                waits=partial(note, f"{asset.name}: another process fetches it; waiting"),
            )
        finally:
            console.close()
        done = f"{got.fetched / 1e6:.1f} MB fetched" if got.fetched else "is there"
        print(f"  {done}: {got.folder}")
    return 0


def references(document: WorkflowDocument) -> set[str]:
    """Return what a workflow and its robot name as `assets:PATH`."""
    from unicon_core.workflow.members import load_robot_of

    robot = load_robot_of(document)
    models = [model for each in (robot, *robot.members.values()) for model in each.models.values()]
    named = (*_strings(document.values), *models)
    return {text for text in named if text.startswith("assets:")}


def fetch_for(document: WorkflowDocument, mirror: str | None = None) -> None:
    """Fetch the assets that a workflow and its robot name and that are not at hand."""
    from unicon_core.assets.manifest import load_assets

    known, missing = load_assets(), set()
    for reference in references(document):
        path = Path(reference.removeprefix("assets:"))
        if not any((root / path).exists() for root in assets_roots()):
            missing |= set(path.parts[1:2]) & known.keys()
    if missing:
        fetch_all(sorted(missing), mirror)


def _strings(value: Any) -> Iterator[str]:
    """Yield the texts in a document."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for each in value.values():
            yield from _strings(each)
    elif isinstance(value, list):
        for each in value:
            yield from _strings(each)


def _show(console: Console, name: str, file: str, done: int, size: int) -> None:
    """Show how far the fetching of an asset is, on a terminal alone."""
    if console.due(EVERY):
        bar = "█" * round(20 * done / max(size, 1))
        console.status({name: f"{bar:<20} {done / 1e6:6.1f} of {size / 1e6:.1f} MB", file: ""})


def _list(arguments: argparse.Namespace) -> int:
    from unicon_core.assets.manifest import asset_folder, load_assets

    known = load_assets()
    assets = {name: each[0] for name, each in known.items() if each[0].name == name}
    folders = {name: asset_folder(asset) for name, asset in assets.items()}
    if arguments.json:
        told = [
            {
                "name": asset.name,
                "kind": asset.kind,
                "bytes": asset.size,
                "files": len(asset.files),
                "licence": asset.licence,
                "repositories": [f"{s.repository}@{s.commit}" for s in asset.sources],
                "folder": None if folders[name] is None else str(folders[name]),
            }
            for name, asset in assets.items()
        ]
        print_json(told)
        return 0
    rows = [
        (a.name, a.kind, f"{a.size / 1e6:.1f}", a.licence, str(folders[a.name] or "-"))
        for a in assets.values()
    ]
    print_table([HEAD, *rows], underlined=True)
    for name in known.keys() - assets.keys():
        print(f"{name}: {' and '.join(asset.name for asset in known[name])}")
    return 0


def _path(arguments: argparse.Namespace) -> int:
    from unicon_core.assets.manifest import asset_folder, load_assets, named

    for asset in named([arguments.name], load_assets()):
        folder = asset_folder(asset)
        if folder is None:
            raise UniconError(
                f"asset {asset.name} is not at hand; get it: unicon assets fetch {asset.name}"
            )
        print(folder)
    return 0


def _verify(arguments: argparse.Namespace) -> int:
    """Verify what is at hand; a folder of `UNICON_ASSETS` may have fewer files, or others."""
    from unicon_core.assets.manifest import asset_folder, load_assets, named, wrong_files

    assets = load_assets()
    chosen = named(arguments.names or [*assets], assets)
    found = {asset: asset_folder(asset) for asset in chosen}
    if missing := [a.name for a, folder in found.items() if folder is None and arguments.names]:
        raise UniconError(
            f"not at hand: {', '.join(missing)}; get it: unicon assets fetch {' '.join(missing)}"
        )
    bad = 0
    for asset, folder in found.items():
        if folder is None:
            continue
        wrong = wrong_files(folder, asset)
        bad += bool(wrong)
        print(f"{asset.name}: {'differs' if wrong else 'as listed'}: {folder}")
        for name, how in wrong.items():
            print(f"  {name}: {how}")
    if not any(found.values()):
        print("nothing is at hand; see: unicon assets list")
    return 1 if bad else 0


add = several(
    "assets",
    "list and fetch public models and policies",
    __doc__,
    "VERB",
    command(
        "list", _list, "what there is, and what is at hand", None, flag("--json", "print JSON")
    ),
    command(
        "fetch",
        lambda arguments: fetch_all(arguments.names, arguments.mirror),
        "fetch assets into the user's cache",
        None,
        option("names", nargs="+", metavar="NAME"),
        argument(
            "--from", "DIR|URL", "a mirror, which has NAME/FILE, instead of GitHub", dest="mirror"
        ),
    ),
    command(
        "path",
        _path,
        "print the folder of an asset that is at hand",
        None,
        option("name", metavar="NAME"),
    ),
    command(
        "verify",
        _verify,
        "compare files with their SHA-256",
        None,
        argument("names", "NAME", "all that was fetched if none", nargs="*"),
    ),
    **EXAMPLES,
)
