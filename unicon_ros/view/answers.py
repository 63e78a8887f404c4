"""Answers: a small HTTP server that never waits for anybody, for figures that a process tells.

One thread, no library: what has come is read, what can leave is written, whoever takes longer than
`PATIENCE` is let go. A slow, stalled or mad client costs nobody else anything.
"""

from __future__ import annotations

import errno
import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from unicon_core.errors import UniconError

__all__ = ["Answers"]

PATIENCE = 2.0
"""Of a request and its answer together, in [s]."""

MOST = 32
"""Clients at once; the oldest is let go for the next one."""

LONGEST = 8192
"""Bytes of a request."""

_WHY = {
    errno.EADDRINUSE: "is taken by another process",
    errno.EACCES: "may not be used by this user",
}

Page = Callable[[], tuple[str, bytes]]
"""Returns the content type and the content of a path."""


@dataclass
class _Client:
    socket: socket.socket
    end: float
    asked: bytes = b""
    answer: memoryview = field(default_factory=lambda: memoryview(b""))
    answered: bool = False


class Answers:
    """Answers GET requests on loopback.

    Args:
        port: to listen at; 0 for any that is free.
        pages: path to what makes it.
        what: stands before errors, such as `--metrics`.

    Attributes:
        port: where it listens.

    Raises:
        UniconError: the port is taken, or may not be used.
    """

    def __init__(self, port: int, pages: dict[str, Page], what: str) -> None:
        self._pages = pages
        self._clients: list[_Client] = []
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._server.bind(("127.0.0.1", port))
            self._server.listen(MOST)
        except (OSError, OverflowError) as error:
            self._server.close()
            why = _WHY.get(getattr(error, "errno", 0), str(error))
            raise UniconError(
                f"{what}: port {port} {why}; give another one, or 0 for any that is free"
            ) from error
        self._server.setblocking(False)
        self.port: int = self._server.getsockname()[1]

    def poll(self) -> None:
        """Take and answer whatever has come; returns at once."""
        self._accept()
        now = time.monotonic()
        for client in list(self._clients):
            try:
                done = self._serve(client)
            except OSError:  # it has gone
                done = True
            if done or now > client.end:
                self._let_go(client)

    def _accept(self) -> None:
        for _ in range(MOST):
            try:
                taken, _ = self._server.accept()
            except OSError:  # nobody, or too many files are open: another time
                return
            taken.setblocking(False)
            self._clients.append(_Client(taken, time.monotonic() + PATIENCE))
            if len(self._clients) > MOST:
                self._let_go(self._clients[0])

    def _serve(self, client: _Client) -> bool:
        """Go on with a client; True when it is done."""
        if not client.answered:
            try:
                came = client.socket.recv(LONGEST)
            except BlockingIOError:
                return False
            client.asked += came
            whole = b"\r\n\r\n" in client.asked or b"\n\n" in client.asked
            if not whole and came and len(client.asked) <= LONGEST:
                return False
            if not whole and not came:
                return True
            client.answer = memoryview(self._answer(client.asked) if whole else _said(431))
            client.answered = True
        while client.answer:
            try:
                client.answer = client.answer[client.socket.send(client.answer) :]
            except BlockingIOError:
                return False
        client.socket.shutdown(socket.SHUT_WR)
        return True

    def _answer(self, asked: bytes) -> bytes:
        words = asked.split(b"\n", 1)[0].decode("latin-1").split()
        if len(words) != 3 or not words[2].startswith("HTTP/"):
            return _said(400)
        method, path = words[0], words[1].split("?", 1)[0]
        if path not in self._pages:
            return _said(404, f"there is {', '.join(self._pages)}\n".encode())
        if method not in ("GET", "HEAD"):
            return _said(405)
        kind, content = self._pages[path]()
        return _said(200, content, kind, head=method == "HEAD")

    def _let_go(self, client: _Client) -> None:
        self._clients.remove(client)
        with suppress(OSError):
            # What was not read would reset the connection, and take the answer with it.
            while select.select([client.socket], [], [], 0.0)[0] and client.socket.recv(1 << 16):
                pass
        client.socket.close()

    def close(self) -> None:
        """Let everybody go."""
        for client in list(self._clients):
            self._let_go(client)
        self._server.close()


_WORDS = {
    200: "OK",
    400: "Bad Request",
    404: "Not Found",
    405: "Method Not Allowed",
    431: "Request Header Fields Too Large",
}


def _said(code: int, content: bytes = b"", kind: str = "text/plain", head: bool = False) -> bytes:
    lines = (
        f"HTTP/1.1 {code} {_WORDS[code]}",
        f"Content-Type: {kind}",
        f"Content-Length: {len(content)}",
        "Cache-Control: no-store",
        "X-Content-Type-Options: nosniff",
        "Connection: close",
    )
    return "\r\n".join(lines).encode() + b"\r\n\r\n" + (b"" if head else content)
