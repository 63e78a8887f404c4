"""A model hub on loopback: as much of huggingface.co's protocol as huggingface_hub asks for."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit

__all__ = ["Hub"]

COMMIT = "0123456789abcdef0123456789abcdef01234567"


class Hub:
    """Serves one repository, `someone/walks`, at one commit.

    Args:
        files: name to content.

    Attributes:
        asked: paths that were asked for.
        url: of the server.
    """

    def __init__(self, files: Mapping[str, bytes]) -> None:
        self.files, self.asked = dict(files), list[str]()
        hub = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                self.answer(body=True)

            def do_HEAD(self) -> None:
                self.answer(body=False)

            def answer(self, *, body: bool) -> None:
                path = unquote(urlsplit(self.path).path)
                hub.asked.append(path)
                status, content, more = hub.found(path)
                self.send_response(status)
                for key, value in {**more, "Content-Length": str(len(content))}.items():
                    self.send_header(key, value)
                self.end_headers()
                if body:
                    self.wfile.write(content)

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.01,), daemon=True
        )
        self._thread.start()

    def found(self, path: str) -> tuple[int, bytes, dict[str, str]]:
        """Return status, content and headers of a path."""
        for revision in ("main", "v1", COMMIT):
            if path in (
                "/api/models/someone/walks",
                f"/api/models/someone/walks/revision/{revision}",
            ):
                return 200, self._info(), {"Content-Type": "application/json"}
            if path == f"/api/models/someone/walks/tree/{revision}":
                return 200, self._tree(), {"Content-Type": "application/json"}
            start = f"/someone/walks/resolve/{revision}/"
            if path.startswith(start) and path[len(start) :] in self.files:
                content = self.files[path[len(start) :]]
                etag = f'"{hashlib.sha256(content).hexdigest()}"'
                return 200, content, {"ETag": etag, "X-Repo-Commit": COMMIT}
        return 404, b"{}", {"X-Error-Code": "RepoNotFound", "X-Error-Message": "not found"}

    def _info(self) -> bytes:
        siblings = [{"rfilename": name} for name in self.files]
        info = {"_id": "1", "id": "someone/walks", "modelId": "someone/walks", "sha": COMMIT}
        return json.dumps({**info, "siblings": siblings, "private": False, "tags": []}).encode()

    def _tree(self) -> bytes:
        files = [
            {"type": "file", "oid": "0" * 40, "size": len(content), "path": name}
            for name, content in self.files.items()
        ]
        return json.dumps(files).encode()

    def close(self) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
