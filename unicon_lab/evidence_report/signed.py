"""Reports of runs as files: written at once or not at all, signed and checked by ssh-keygen.

The signature is OpenSSH's own (`ssh-keygen -Y`): an agent, a passphrase or a token works.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import yaml

from unicon_base.errors import UniconError
from unicon_base.located_yaml import read_yaml
from unicon_core.page import write_file
from unicon_lab.evidence_report.report import SCHEMA

NAMESPACE = "unicon-run"
"""Of signatures: one that was made for another purpose signs no report."""


def text_of(report: dict[str, Any]) -> str:
    """Return a report as YAML."""
    return str(yaml.safe_dump(report, sort_keys=False, allow_unicode=True, width=100))


def signature_of(path: Path) -> Path:
    """Return where the signature of a report is."""
    return path.with_name(f"{path.name}.sig")


def read_report(path: Path) -> dict[str, Any]:
    """Return what a report says.

    Raises:
        UniconError: it cannot be read, or is none.
    """
    value = read_yaml(path, UniconError).value
    if not isinstance(value, dict) or value.get("schema") != SCHEMA:
        raise UniconError(f"{path} is no report of a run: give what unicon report-run has written")
    return value


def refuse_existing(path: Path, force: bool) -> None:
    """Refuse to write where something is; with `force` where something is that is no file."""
    for each in (path, signature_of(path)):
        if os.path.lexists(each) and not (force and each.is_file()):
            remedy = "give another --out" + (", or --force" if each.is_file() else "")
            raise UniconError(f"{each} exists; {remedy}")


def write_report(path: Path, text: str, signature: bytes) -> None:
    """Write a report and its signature, or neither; a signature of before goes.

    Raises:
        UniconError: it cannot be written.
    """
    beside = signature_of(path)
    beside.unlink(missing_ok=True)
    try:
        if signature:
            write_file(beside, signature)
        write_file(path, text.encode())
    except UniconError:
        beside.unlink(missing_ok=True)
        raise


def sign(text: str, key: Path) -> bytes:
    """Return the signature of a report by the user's SSH key; ssh-keygen asks for its passphrase.

    Raises:
        UniconError: there is no such key or no ssh-keygen, or it refuses.
    """
    what = f"cannot sign with {key} (give a key, or FILE.pub of one that ssh-agent has)"
    arguments = ("sign", "-n", NAMESPACE, "-f", str(key.expanduser().absolute()))
    return f"{_keygen(text.encode(), what, *arguments)}\n".encode()


def signed_by(path: Path, allowed: Path | None = None) -> str:
    """Return who signed a report, as ssh-keygen tells it.

    Args:
        path: of the report; its signature is beside it, as FILE.sig.
        allowed: OpenSSH's file of signers that count; None for any key.

    Raises:
        UniconError: it is not signed, was changed, or its key is none of those.
    """
    beside = signature_of(path)
    if not beside.is_file():
        raise UniconError(f"{path} is not signed: {beside} is not there; sign with --sign KEY")
    content, what = path.read_bytes(), f"{path} is not what {beside.name} signs"
    given = ("-n", NAMESPACE, "-s", str(beside.absolute()))
    if allowed is None:
        return _keygen(content, what, "check-novalidate", *given)
    if not allowed.is_file():
        raise UniconError(f"{allowed} is not there; give OpenSSH's file of allowed signers")
    signers = ("-f", str(allowed.absolute()))
    nobody = f"{path} is signed by no key of {allowed}"
    names = _keygen(content, nobody, "find-principals", *signers, *given[2:]).splitlines()
    return _keygen(content, what, "verify", "-I", names[0], *signers, *given)


def _keygen(content: bytes, what: str, *arguments: str) -> str:
    """Return what ssh-keygen says; raise an error that begins with `what` where it refuses."""
    try:
        done = subprocess.run(["ssh-keygen", "-Y", *arguments], input=content, capture_output=True)
    except FileNotFoundError as error:
        raise UniconError(
            "ssh-keygen is not there, which makes and checks signatures: apt install openssh-client"
        ) from error
    if done.returncode:
        told = (done.stderr or done.stdout).decode(errors="replace").split("\n")
        raise UniconError(f"{what}: {next(filter(None, map(str.strip, told)), 'no reason given')}")
    return done.stdout.decode().strip()
