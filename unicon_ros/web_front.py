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
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from urllib.parse import urlsplit

from unicon_base import UniconError

LOOPBACK = ("127.0.0.1", "localhost", "::1")
SHORTEST = 8
"""Characters of a token."""
LONGEST_HEAD = 16_384
"""Bytes of a request's head."""
PATIENCE = 5.0
"""How long a client may take for its head, in [s]."""
CLIENTS = 64
"""Who were let in, at once; as many may still be asked who they are."""
PORTS = 100
"""That are tried from the first one on."""


def check_reach(host: str, token: str) -> None:
    """Refuse a viewer that everybody in the network could drive from.

    Raises:
        UniconError: a host beyond this machine without a token, or a token that is none.
    """
    if token and (len(token) < SHORTEST or not token.isascii() or not token.isalnum()):
        raise UniconError(
            f"--view-token {token!r} is not a token; give {SHORTEST} or more letters and digits"
        )
    if host not in LOOPBACK and not token:
        raise UniconError(
            f"--view-host {host} lets everybody in the network drive the robot; add --view-token "
            "TOKEN, or leave --view-host out and come through ssh -L"
        )


def refusal(headers: Mapping[str, str], path: str, token: str, origins: Sequence[str] = ()) -> str:
    """Return why a client may not come in, "" where it may.

    Another site's page, open in the same browser, can reach 127.0.0.1 too: it tells its own origin,
    or, where it had its name point here, a host that is not this one.

    Args:
        headers: of the request that opens the websocket.
        path: of that request; `/TOKEN` where one is needed.
        token: "" for none.
        origins: of other sites whose pages may. With the token so may pages that other servers of
            this machine serve.
    """
    host, origin = headers.get("Host", ""), headers.get("Origin")
    try:
        name = urlsplit(f"//{host}").hostname or ""
        site = urlsplit(origin) if origin else urlsplit(f"//{host}")
        beside = bool(token) and site.hostname in LOOPBACK
    except ValueError:
        return "its address cannot be read"
    if token:
        given = path.strip("/").encode(errors="replace")
        if not hmac.compare_digest(given, token.encode()):
            return "it does not know the token"
    elif name not in LOOPBACK:
        return f"it asks for host {name!r}"
    mine = site.netloc == host or beside or origin in origins
    return "" if mine else f"it is a page of {origin}"


def netloc(host: str, port: int) -> str:
    """Return host and port as an address has them."""
    return f"{f'[{host}]' if ':' in host else host}:{port}"


def hidden_address() -> str:
    """Return an address of 127.0.0.0/8 that others do not know."""
    return f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(256)}.{secrets.randbelow(254) + 1}"


class Front:
    """Listens, and lets those in who may come.

    Args:
        host: where it listens.
        port: the first one that is tried.
        behind: address and port of the server.
        origins: other sites whose pages may come in, as of `refusal`.
        token: that a client has to give as its path; needed beyond this machine.
        warn: takes why a client was refused.

    Attributes:
        port: where it listens.
        at: the same with the host, as an address has it.
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
        check_reach(host, token)
        self._behind, self._origins, self._token, self._warn = behind, origins, token, warn
        self._server = listening(host, port)
        self.port: int = self._server.getsockname()[1]
        self.at = netloc(host, self.port)
        self.refused = self._clients = 0
        self._asked: list[asyncio.StreamWriter] = []
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="front", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        serving = asyncio.start_server(self._come, sock=self._server, limit=LONGEST_HEAD)
        self._loop.run_until_complete(serving)
        self._loop.run_forever()
        left = asyncio.all_tasks(self._loop)
        for task in left:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))

    async def _come(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inside = False
        self._asked.append(writer)
        if len(self._asked) > CLIENTS:  # the longest silent client makes room
            self._asked.pop(0).transport.abort()
        try:
            with suppress(OSError, asyncio.TimeoutError, asyncio.LimitOverrunError, EOFError):
                head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), PATIENCE)
                why = self._refusal(head)
                if not why and self._clients >= CLIENTS:
                    why = "too many are here"
                if why:
                    self.refused += 1
                    self._warn(f"a viewer was refused: {why}")
                    line = f"HTTP/1.1 403 Forbidden\r\nContent-Length: {len(why)}\r\n\r\n{why}"
                    writer.write(line.encode())
                    await writer.drain()
                    return
                inside = True
                self._clients += 1
                self._asked.remove(writer)
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
            self._clients -= inside
            if writer in self._asked:
                self._asked.remove(writer)
            with suppress(Exception):
                writer.close()

    def _refusal(self, head: bytes) -> str:
        first, *lines = head.decode("latin-1").split("\r\n")
        pairs = (line.partition(":") for line in lines)
        headers = {key.strip().title(): value.strip() for key, _, value in pairs}
        path = first.split(" ")[1] if first.count(" ") == 2 else "/"
        return refusal(headers, path, self._token, self._origins)

    def close(self) -> None:
        """Let nobody in any more."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(2.0)
        self._server.close()


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens at a port, or at the next free one; at any for 0.

    Raises:
        UniconError: the host is not this machine's, or no port is free.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    last = min(port + PORTS - 1, 65535) if port else 0
    for number in range(port, last + 1):
        server = socket.socket(family)
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind((host, number))
            server.listen(CLIENTS)
        except OSError as error:
            server.close()
            if number == last or error.errno not in (98, 13):
                where, why = f"--view-host {host} --view-port {number}", error.strerror or error
                raise UniconError(f"{where}: {why}; give others") from error
            continue
        server.setblocking(False)
        return server
    raise AssertionError


async def _pipe(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
