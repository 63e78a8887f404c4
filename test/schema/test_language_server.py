"""An editor's language server completes a workflow and underlines a wrong key, by our schema."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]

SCHEMA = Path(__file__).resolve().parents[2] / "config" / "schemas" / "workflow.json"
INSTALL = "npm install --global yaml-language-server"
HEAD = f"# yaml-language-server: $schema={SCHEMA.as_uri()}\nrobot: go2\nplatform: mujoco\n"


class Server:
    """yaml-language-server over its standard input and output.

    Args:
        script: of the server.
    """

    def __init__(self, script: Path) -> None:
        self._process = subprocess.Popen(
            ["node", str(script), "--stdio"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self._number = 0
        text_document = {"completion": {"completionItem": {"snippetSupport": False}}}
        capabilities = {"textDocument": text_document}
        self.ask("initialize", processId=None, rootUri=None, capabilities=capabilities)
        self.tell("initialized")

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def tell(self, method: str, **parameters: Any) -> None:
        self._send({"method": method, "params": parameters})

    def ask(self, method: str, **parameters: Any) -> Any:
        self._number += 1
        self._send({"id": self._number, "method": method, "params": parameters})
        return self._until(lambda message: message.get("id") == self._number)["result"]

    def completed(self, uri: str, line: int, character: int) -> list[str]:
        found = self.ask(
            "textDocument/completion",
            textDocument={"uri": uri},
            position={"line": line, "character": character},
        )
        return [item["label"] for item in found["items"]]

    def underlined(self, uri: str) -> dict[int, str]:
        """Return line, from 0, to message."""
        found = self._until(
            lambda message: (
                message.get("method") == "textDocument/publishDiagnostics"
                and message["params"]["uri"] == uri
            )
        )["params"]["diagnostics"]
        return {each["range"]["start"]["line"]: each["message"] for each in found}

    def open(self, uri: str, text: str) -> None:
        document = {"uri": uri, "languageId": "yaml", "version": 1, "text": text}
        self.tell("textDocument/didOpen", textDocument=document)

    def _send(self, message: dict[str, Any]) -> None:
        body = json.dumps({"jsonrpc": "2.0", **message}).encode()
        assert self._process.stdin is not None
        self._process.stdin.write(b"Content-Length: %d\r\n\r\n" % len(body) + body)
        self._process.stdin.flush()

    def _until(self, wanted: Any) -> dict[str, Any]:
        while True:
            message = self._receive()
            if "method" in message and "id" in message:  # it asks for its configuration
                empty = [{} for _ in message.get("params", {}).get("items", ())]
                self._send({"id": message["id"], "result": empty})
            elif wanted(message):
                return message

    def _receive(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        length = 0
        while line := self._process.stdout.readline().strip():
            name, _, value = line.partition(b":")
            length = int(value) if name.lower() == b"content-length" else length
        message: dict[str, Any] = json.loads(self._process.stdout.read(length))
        return message


@pytest.fixture
def server() -> Iterator[Server]:
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip(f"no node: apt-get install nodejs npm; {INSTALL}")
    root = subprocess.run([npm, "root", "--global"], capture_output=True, text=True, timeout=60)
    script = Path(root.stdout.strip()) / "yaml-language-server" / "bin" / "yaml-language-server"
    if not script.is_file():
        pytest.skip(f"no language server: {INSTALL}")
    running = Server(script)
    yield running
    running.close()


def test_keys_blocks_and_options_are_completed(server: Server) -> None:
    cases = {
        "sc": {"scene", "safety", "pacing"},
        "scene:\n  in": {"initial_pose", "gantry", "push"},
        "safety:\n- tilt_stop:\n    an": {"angle"},
        "flow:\n  ch": {"chain", "pose", "policy"},
        "platforms:\n  mujoco:\n    pa": {"passive"},
        "pacing:\n  overrun: s": {"skip", "catch_up"},
    }
    for number, (text, wanted) in enumerate(cases.items()):
        uri = f"file:///completed{number}.yaml"
        server.open(uri, HEAD + text)
        *_, last = (HEAD + text).splitlines()
        found = server.completed(uri, (HEAD + text).count("\n"), len(last))
        assert wanted <= set(found), text


def test_a_wrong_key_is_underlined_and_a_right_file_is_not(server: Server) -> None:
    server.open("file:///right.yaml", f"{HEAD}rate: 50\nflow: hold\n")
    assert server.underlined("file:///right.yaml") == {}
    server.open("file:///wrong.yaml", f"{HEAD}ratee: 50\nflow: hold\nscene: {{gravity: 0}}\n")
    found = server.underlined("file:///wrong.yaml")
    assert set(found) == {3, 5}
    assert "ratee" in found[3]
    assert "gravity" in found[5]
