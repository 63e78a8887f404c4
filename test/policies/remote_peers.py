"""Servers of networks for tests: in a thread, in a process, and behind a slow link."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from slow_network import workflow
from zmq.auth import create_certificates

from unicon_base.resources import same_modules
from unicon_core.policies import load_policy
from unicon_core.policies.networks.remote_server import PolicyServer

ANY = "tcp://127.0.0.1:*"


@contextmanager
def serving(
    folder: Path | str, address: str = ANY, kind: Any = PolicyServer, keys: Path | None = None
) -> Iterator[PolicyServer]:
    """A server in a thread of this process."""
    with closing(kind(load_policy(folder), address, keys)) as server:
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.stop()
            thread.join()


@contextmanager
def served(folder: Path | str, *more: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`unicon serve` in a process; yields it and its address."""
    command = [sys.executable, "-m", "unicon_ros", "serve", str(folder), "--bind", ANY, *more]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=same_modules())
    assert process.stdout is not None
    try:
        said = ""
        while "hash " not in said:
            line = process.stdout.readline()
            assert line, said
            said += line
        found = re.search(r"tcp://\S+", said)
        assert found is not None
        yield process, found[0]
    finally:
        process.kill()
        process.communicate()


def asking(folder: Path, address: str, **more: Any) -> dict[str, Any]:
    """Return a workflow whose policy is at a server; options of `remote`, others of the rest."""
    spec = {name: more.pop(name) for name in ("delay", "timeout", "keys") if name in more}
    values = workflow(folder, None, **more)
    values["policies"]["slow"]["remote"] = {"address": address, **spec}
    return values


def make_keys(folder: Path) -> Path:
    """Write the keys of a server and of a client that it knows."""
    (folder / "clients").mkdir(parents=True)
    for name in ("server", "client"):
        create_certificates(folder, name)
    (folder / "clients/robot.key").write_bytes((folder / "client.key").read_bytes())
    return folder
