"""Fetching: a policy from where it is published, by the library of its publisher.

    hf://OWNER/REPO[@REVISION][/PATH]          huggingface_hub
    wandb://ENTITY/PROJECT/RUN[/PATH]          wandb: files of a run
    wandb://ENTITY/PROJECT/NAME:VERSION[/PATH] wandb: an artifact
    file:///PATH

What is fetched is imported, as `import_policy` does, and stands in its folder whole or not at all.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import TypeAlias
from urllib.parse import unquote, urlsplit

import yaml

from unicon_base import AnyMapping, PolicyError, alternatives, cannot, imported, one_line
from unicon_base.located_yaml import read_yaml
from unicon_base.resources import sha256_of
from unicon_core.policies.contract import TORCHSCRIPT
from unicon_core.policies.load import ImportReport, import_policy, refuse_to_replace
from unicon_core.robots import Robot

NETWORKS = (".onnx", *TORCHSCRIPT)
KINDS = (*NETWORKS, ".data", ".yaml", ".yml", ".npz", ".csv")
"""Endings of files that a policy is made of; no others are fetched."""


@dataclass(frozen=True)
class FetchReport:
    """What was fetched.

    Attributes:
        source: where from, with the revision that it was.
        sha256: name of each network's file to its SHA-256.
        report: of the import.
    """

    source: str
    sha256: dict[str, str]
    report: ImportReport

    def __str__(self) -> str:
        digests = [f"sha256 {digest}  {name}" for name, digest in self.sha256.items()]
        return "\n".join([f"fetched {self.source}", *digests, str(self.report)])


# Where a policy lies by now, and what exactly it is.
_Fetched: TypeAlias = tuple[Path, str]


def fetch_policy(
    url: str,
    out_dir: str | Path,
    *,
    sha256: str | None = None,
    force: bool = False,
    robot: Robot | None = None,
    given: AnyMapping | None = None,
) -> FetchReport:
    """Fetch a policy, and write it as `policy.yaml` with its network beside it.

    Args:
        url: see the module.
        out_dir: folder to write, all at once; it must not be there.
        sha256: of the network's file, 64 digits; another one is refused.
        force: replace the folder of a policy that is there.
        robot: as of `load_policy`.
        given: as of `load_policy`.

    Raises:
        PolicyError: it cannot be had, is another one than `sha256` says, or the folder is there.
        MissingDependencyError: the library for it is not installed.
    """
    out = Path(os.path.abspath(out_dir))
    if sha256 is not None and (len(sha256) != 64 or set(sha256.lower()) - set("0123456789abcdef")):
        raise PolicyError(f"--sha256 {sha256}: give the 64 digits of 'sha256sum'")
    refuse_to_replace(out, force)
    if os.path.lexists(out) and (out.is_symlink() or not (out / "policy.yaml").is_file()):
        raise PolicyError(f"{out} is not the folder of a policy; give another --out")
    get = _source(url)
    with cannot(f"write {out}", "give another --out"):
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.")
    with folder as name:
        path, source = get(Path(name) / "fetched")
        new = Path(name) / "new"
        report = import_policy(path, new, robot=robot, given=given)
        digests = _digests(new, url, sha256, source)
        _put(new, out, Path(name) / "old")
    return FetchReport(source, digests, replace(report, path=out / report.path.name))


def _digests(folder: Path, url: str, wanted: str | None, source: str) -> dict[str, str]:
    """Return the hashes of the networks, that of the action first; note the source in the policy.

    Raises:
        PolicyError: it is not the one that is wanted.
    """
    path = folder / "policy.yaml"
    values = read_yaml(path, PolicyError, foreign=True).value
    main = values.get("onnx") or values.get("torchscript")
    if main is None:
        raise PolicyError(f"{url}: no single network is with it; name its file at the end")
    others = (part["onnx"] for part in (values.get("networks") or {}).values())
    digests = {name: sha256_of(folder / name) for name in (main, *others)}
    if wanted is not None and digests[main] != wanted.lower():
        raise PolicyError(
            f"{url}: {main} has sha256 {digests[main]}, and --sha256 says {wanted}; nothing was "
            "written: make sure which one you want"
        )
    if "sources" not in values:
        with path.open("a", encoding="utf-8") as file:
            yaml.safe_dump({"sources": {"fetched": source}}, file)
    return digests


def _put(new: Path, out: Path, old: Path) -> None:
    """Let a folder be another one, at once; what was there goes to `old`."""
    with cannot(f"write {out}", "give another --out"):
        if os.path.lexists(out):
            os.rename(out, old)
        try:
            os.rename(new, out)
        except OSError:
            if os.path.lexists(old):
                os.rename(old, out)
            raise


def _source(url: str) -> Callable[[Path], _Fetched]:
    """Return what fetches a URL into a new folder.

    Raises:
        PolicyError: it is of no known form.
    """
    scheme, mark, rest = url.partition("://")
    parts = [part for part in rest.split("/") if part]
    getters = {"hf": (_hugging_face, 2), "wandb": (_wandb, 3), "file": (_file, 0)}
    if not mark or scheme not in getters:
        schemes = "hf://OWNER/REPO, wandb://ENTITY/PROJECT/RUN, file:///PATH"
        raise PolicyError(f"policies fetch {url!r}: give {schemes}")
    if scheme != "file" and {*parts} & {".", ".."}:
        raise PolicyError(f"policies fetch {url!r}: leave out '.' and '..'")
    get, least = getters[scheme]
    if len(parts) < least:
        wanted = "wandb://ENTITY/PROJECT/RUN" if least > 2 else "hf://OWNER/REPO[@REVISION][/PATH]"
        raise PolicyError(f"policies fetch {url!r}: give {wanted}")
    return partial(get, url, "/".join(parts[:least]), "/".join(parts[least:]))


def _file(url: str, place: str, path: str, into: Path) -> _Fetched:
    split = urlsplit(url)
    if split.netloc not in ("", "localhost"):
        raise PolicyError(f"policies fetch {url!r}: a file of this machine has three slashes")
    found = Path(unquote(split.path))
    if not found.exists():
        raise PolicyError(f"policies fetch {url!r}: no such file or folder {found}")
    return found, found.resolve().as_uri()


def _hugging_face(url: str, place: str, path: str, into: Path) -> _Fetched:
    huggingface_hub = imported("huggingface_hub", f"policies fetch {url}")
    owner, named = place.split("/")
    name, _, revision = named.partition("@")
    repo, folder = f"{owner}/{name}", into / name
    with _told(url, "huggingface_hub"):
        info = huggingface_hub.HfApi().model_info(repo, revision=revision or None)
        there = [str(file.rfilename) for file in info.siblings or ()]
        names = _wanted(url, there, path)
        huggingface_hub.snapshot_download(
            repo, revision=info.sha, local_dir=folder, allow_patterns=list(map(glob.escape, names))
        )
    return folder / path, f"hf://{repo}@{info.sha}{path and f'/{path}'}"


def _wandb(url: str, place: str, path: str, into: Path) -> _Fetched:
    wandb = imported("wandb", f"policies fetch {url}")
    last = place.rpartition("/")[2]
    folder = into / last.partition(":")[0]
    with _told(url, "wandb"):
        found = (wandb.Api().artifact if ":" in last else wandb.Api().run)(place)
        if ":" in last:
            place = f"{place.rpartition(':')[0]}:{found.version}"
        files = {str(file.name): file for file in found.files()}
        for name in _wanted(url, files, path):
            files[name].download(root=str(folder), replace=True)
    return folder / path, f"wandb://{place}{path and f'/{path}'}"


def _wanted(url: str, there: Iterable[str], path: str) -> list[str]:
    """Return the names of the files that a policy needs.

    Args:
        url: for messages.
        there: names of the files that are there.
        path: a file or folder among them, or "".

    Raises:
        PolicyError: it is not there, or a name leads out of the folder.
    """
    names = [name for name in there if name.endswith(KINDS)]
    for name in names:
        pure = PurePosixPath(name)
        if pure.is_absolute() or ".." in pure.parts or "\\" in name:
            raise PolicyError(f"{url}: the name {name!r} leads out of its folder; it is refused")
    folder = path
    if path in names:
        folder = path.rpartition("/")[0]
        if path.endswith(NETWORKS):  # others beside it are other policies, but for its weights
            names = [name for name in names if name == path or not name.endswith(NETWORKS)]
    inside = [name for name in names if not folder or name.startswith(f"{folder}/")]
    if not inside:
        what = (
            f"nothing of a policy is under {path!r}" if path else "no files of a policy are there"
        )
        raise PolicyError(f"{url}: {what}; {alternatives(path, names)}")
    return inside


@contextmanager
def _told(url: str, library: str) -> Iterator[None]:
    """Turn whatever a library raises into one line."""
    try:
        yield
    except PolicyError:
        raise
    except Exception as error:
        text = one_line(error)[:300]
        raise PolicyError(f"{url}: {library} cannot get it: {text}") from error
