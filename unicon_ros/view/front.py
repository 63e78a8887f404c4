"""Front: the door before a server that asks nobody who they are: origin and token, then bytes.

A page of another site, open in a browser of this machine, can reach 127.0.0.1 as well as our own
page can, and could drive. It tells its origin, by which it is refused. The server behind the door
listens at a loopback address that is drawn anew each time, which nobody else knows.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import socket
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from urllib.parse import parse_qs, urlsplit

from unicon_core.errors import UniconError

__all__ = ["Front", "hidden_address"]

LOOPBACK = ("127.0.0.1", "localhost", "::1")
LONGEST_HEAD = 16_384
"""Bytes of a request's head."""
PATIENCE = 5.0
"""How long a client may take for its head, in [s]."""
CLIENTS = 64
"""At once."""
PORTS = 100
"""That are tried from the first one on."""


def hidden_address() -> str:
    """Return an address of 127.0.0.0/8 that others do not know."""
    return f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(256)}.{secrets.randbelow(254) + 1}"


class Front:
    """Listens, and lets those in who may come.

    Args:
        host: where it listens.
        port: the first one that is tried.
        behind: address and port of the server.
        origins: sites whose pages may come, besides those of this machine.
        token: that a client has to give as `?token=`; needed beyond this machine.

    Attributes:
        port: where it listens.
        refused: how many were not let in.

    Raises:
        UniconError: no port is free, or a host beyond this machine has no token.
    """

    def __init__(
        self,
        host: str,
        port: int,
        behind: tuple[str, int],
        origins: Sequence[str] = (),
        token: str = "",
        warn: Callable[[str], object] = bool,
    ) -> None:
        if host not in LOOPBACK and not token:
            raise UniconError(
                f"--view-host {host} lets everybody in the network in; add --view-token TOKEN, or "
                "leave --view-host out and come through ssh -L"
            )
        self._behind, self._origins, self._token, self._warn = behind, origins, token, warn
        self._server = _listening(host, port)
        self.port: int = self._server.getsockname()[1]
        self.refused = self._clients = 0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="front", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        serving = asyncio.start_server(self._come, sock=self._server, limit=LONGEST_HEAD)
        self._loop.run_until_complete(serving)
        self._loop.run_forever()

    async def _come(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._clients += 1
        try:
            with suppress(OSError, asyncio.TimeoutError, asyncio.LimitOverrunError, EOFError):
                head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), PATIENCE)
                why = "too many are here" if self._clients > CLIENTS else self._refusal(head)
                if why:
                    self.refused += 1
                    self._warn(f"a viewer was refused: {why}")
                    line = f"HTTP/1.1 403 Forbidden\r\nContent-Length: {len(why)}\r\n\r\n{why}"
                    writer.write(line.encode())
                    await writer.drain()
                    return
                inner_reader, inner_writer = await asyncio.open_connection(*self._behind)
                inner_writer.write(head)
                ways = (_pipe(reader, inner_writer), _pipe(inner_reader, writer))
                _, rest = await asyncio.wait(
                    [asyncio.ensure_future(way) for way in ways],
                    return_when=asyncio.FIRST_COMPLETED,
                )
                for way in rest:
                    way.cancel()
                inner_writer.close()
        finally:
            self._clients -= 1
            with suppress(Exception):
                writer.close()

    def _refusal(self, head: bytes) -> str:
        """Return why a client may not come in, "" where it may."""
        first, *lines = head.decode("latin-1").split("\r\n")
        given = {
            key.strip().lower(): value.strip()
            for key, _, value in (x.partition(":") for x in lines)
        }
        path = first.split(" ")[1] if first.count(" ") == 2 else "/"
        if self._token:
            told = parse_qs(urlsplit(path).query).get("token", [""])[0]
            if not hmac.compare_digest(told.encode(), self._token.encode()):
                return "it does not know the token"
        elif _host(f"//{given.get('host', '')}") not in LOOPBACK:
            return f"it asks for {given.get('host', 'no host')}"  # a name that was made point here
        origin = given.get("origin")
        if origin is None or origin in self._origins or _host(origin) in LOOPBACK:
            return ""
        return f"it is a page of {origin}"

    def close(self) -> None:
        """Let nobody in any more."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(2.0)
        self._server.close()


def _host(url: str) -> str | None:
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for number in range(port, port + PORTS) if port else (0,):
        server = socket.socket(family)
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind((host, number))
            server.listen(CLIENTS)
        except OSError as error:
            server.close()
            if number == port + PORTS - 1 or error.errno not in (98, 13):
                raise UniconError(
                    f"--view-host {host} --view-port {number}: {error.strerror}; give others"
                ) from error
            continue
        server.setblocking(False)
        return server
    raise AssertionError


async def _pipe(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
