"""The process of `webxr`: serves the page, and tells what a headset that shows it sends."""

from __future__ import annotations

import asyncio
import datetime
import ipaddress
import logging
import os
import socket
import ssl
import time
from contextlib import suppress
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import ServerConnection
from websockets.asyncio.server import serve as websocket
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State

from unicon_base import AnyDict, UniconError, imported
from unicon_base.resources import user_folder
from unicon_hardware.peripherals.webxr.webxr import (
    ANSWER,
    FRAME,
    PARTS,
    PICTURE,
    Clock,
    Eye,
    Frame,
    Refused,
)
from unicon_ros.peripheral_process import SLICE, Feed, end, serve
from unicon_ros.web_front import netloc, refusal

_DAY = datetime.timedelta(days=1)


def certificate(host: str) -> Path:
    """Return the file of key and certificate for a host, mode 0600; made where there is none.

    It lies in `$XDG_STATE_HOME/unicon/webxr`. One that has expired, is for another host, or cannot
    be read is made again: the browser asks again then.

    Args:
        host: address where the page is served.

    Raises:
        MissingDependencyError: `cryptography` is not installed.
        UniconError: it cannot be written.
    """
    x509 = imported("cryptography.x509", "webxr over TLS", "webxr")
    folder = user_folder("webxr")
    if folder is None:
        raise UniconError("webxr: no home to keep a certificate in; set XDG_STATE_HOME")
    path = folder / "certificate.pem"
    names = [x509.DNSName("localhost"), x509.DNSName(socket.gethostname() or "robot")]
    for address in dict.fromkeys(("127.0.0.1", host)):
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(address)))
        except ValueError:
            names.append(x509.DNSName(address))
    now = datetime.datetime.now(datetime.timezone.utc)
    with suppress(OSError, ValueError, x509.ExtensionNotFound):
        found = x509.load_pem_x509_certificate(path.read_bytes())
        served = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        private = path.stat().st_mode & 0o077 == 0
        if private and now < found.not_valid_after_utc - _DAY and set(names) <= set(served):
            return path
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        fresh = folder / f"certificate.{os.getpid()}"
        fresh.unlink(missing_ok=True)
        file = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(file, "wb") as out:
            out.write(_made(names, now))
        fresh.rename(path)
    except OSError as error:
        raise UniconError(f"webxr: {path}: {error.strerror}; make the folder writable") from error
    return path


def _made(names: list[Any], now: datetime.datetime) -> bytes:
    """Return a new key, and its certificate for these names from now on."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "unicon webxr")])
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _DAY)
        .not_valid_after(now + 800 * _DAY)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return bytes(secret + made.public_bytes(serialization.Encoding.PEM))


def fingerprint(path: Path) -> str:
    """Return a certificate's SHA-256 as browsers show it."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    found = x509.load_pem_x509_certificate(path.read_bytes())
    return bytes(found.fingerprint(hashes.SHA256())).hex(":")


def secured(path: Path) -> ssl.SSLContext:
    """Return the server's TLS with a certificate."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(path)
    return context


SCRIPT = "/page.js"
PAGES = {"/": ("page.html", "text/html"), SCRIPT: ("page.js", "text/javascript")}
POSES, CAMERA = "/poses", "/camera/"
"""Paths of the websockets; the number of an eye follows the second."""
GLANCE, LOOKING = 0.004, 8
"""How often a page that waits looks for a new picture, in [s]; most that look at once."""

EVERY = 0.25
"""How often the page's clock is asked for, in [s]."""
TAKEN = 4001
"""Close code: another headset is there."""
PATIENCE = 1.0
"""A headset that is silent for so long gives way to another, in [s]."""

HEADERS = {
    "Connection": "close",
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self'; style-src 'unsafe-inline'; img-src data:",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class WebXr:
    """The device: a server that is always there. The headset comes and goes.

    Args:
        feed: whose options say where it is served.

    Raises:
        UniconError: it cannot be served there.
    """

    def __init__(self, feed: Feed) -> None:
        options = feed.options
        self._feed, self._token, self._stale = feed, options["token"], options["stale"]
        self._host, self._tls = options["host"], options["tls"]
        self._eyes: list[Eye | None] = [None] * options["cameras"]
        self._looking, self._note = 0, ""
        self._headset: ServerConnection | None = None
        self._heard = 0.0
        self._number, self._missed, self._refused = -1, 0, 0
        self._why: set[str] = set()
        self._pages = {
            path: (files(__package__).joinpath(name).read_bytes(), kind)
            for path, (name, kind) in PAGES.items()
        }
        page, kind = self._pages["/"]
        self._pages["/"] = page.replace(b'="0"', b'="%d"' % len(self._eyes), 1), kind
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        self._path = certificate(self._host) if self._tls else None
        self._loop = asyncio.new_event_loop()
        asyncio.set_event_loop(self._loop)
        try:
            self._server = self._loop.run_until_complete(self._serving(options["port"]))
        except OSError as error:
            raise UniconError(
                f"webxr: cannot be served at {self._host}:{options['port']}: "
                f"{error.strerror or error}; give another host or port"
            ) from error

    async def _serving(self, port: int) -> Any:
        return await websocket(
            self._session,
            self._host,
            port,
            ssl=secured(self._path) if self._path else None,
            process_request=self._request,
            compression=None,
            max_size=2 * FRAME.itemsize,
            open_timeout=5.0,
            ping_interval=2.0,
            ping_timeout=4.0,
            close_timeout=0.5,
            server_header=None,
            family=socket.AF_INET6 if ":" in self._host else socket.AF_INET,
        )

    def first(self) -> AnyDict:
        """Return where it is served."""
        port = self._server.sockets[0].getsockname()[1]
        address = f"{'https' if self._tls else 'http'}://{netloc(self._host, port)}/"
        line = f"{self._feed.name}: open {address}{'?token=…' * bool(self._token)} in the headset"
        if self._path is not None:
            line += f"; the certificate is our own, SHA-256 {fingerprint(self._path)}"
        self._feed.tell(line)
        return {"address": address}

    def poll(self) -> None:
        """Serve for a while; poses are told as they come."""
        for what, *given in self._feed.wishes:
            if what == "cameras":
                self._eyes = [each and Eye(*each) for each in given]
            else:
                self._note = given[0]
        self._feed.wishes.clear()
        self._loop.run_until_complete(asyncio.sleep(SLICE))

    def _request(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request for a page; None lets a websocket open."""
        url = urlsplit(request.path)
        given = parse_qs(url.query).get("token", [""])[0]
        if url.path == SCRIPT:  # which says nothing of us
            given = self._token
        why = refusal(request.headers, given, self._token)
        if why:
            self._refuse(why)
            return connection.respond(HTTPStatus.FORBIDDEN, f"Not for you: {why}.\n")
        if url.path in (POSES, *(f"{CAMERA}{n}" for n in range(len(self._eyes)))):
            return None
        if url.path not in self._pages:
            return connection.respond(HTTPStatus.NOT_FOUND, "There is only the page at /.\n")
        body, kind = self._pages[url.path]
        about = {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body))}
        return Response(HTTPStatus.OK, "OK", Headers(HEADERS | about), body)

    async def _session(self, connection: ServerConnection) -> None:
        """Hear a headset until it leaves."""
        path = urlsplit(connection.request.path).path if connection.request else ""
        if path != POSES:
            with suppress(ConnectionClosed):
                await self._show(connection, int(path.removeprefix(CAMERA)))
            return
        before = self._headset
        if before is not None and time.monotonic() - self._heard < PATIENCE:
            await connection.close(TAKEN, "another headset is connected")
            return
        self._headset, self._heard = connection, time.monotonic()
        self._number, self._missed = -1, 0
        if before is not None:
            before.transport.abort()
        clock = Clock()
        asking = asyncio.ensure_future(self._ask(connection, clock))
        self._feed.tell(f"{self._feed.name}: a headset came from {connection.remote_address[0]}")
        try:
            async for data in connection:
                if self._headset is connection:
                    self._take(data, clock)
        except ConnectionClosed as closed:
            if closed.sent is not None and closed.sent.code == 1009:
                self._refuse("too long")
        finally:
            asking.cancel()
            if self._headset is connection:
                self._headset = None
                self._feed.neutral()
                self._feed.tell(f"{self._feed.name}: the headset has left; its values are neutral")

    async def _show(self, connection: ServerConnection, number: int) -> None:
        """Send the newest picture each time that a page asks: nothing waits for a slow one."""
        if self._looking == LOOKING:
            await connection.close(TAKEN, "too many pages look at the cameras")
            return
        self._looking += 1
        try:
            seen, note = 0, ""
            async for _ in connection:
                since = time.monotonic()
                while (eye := self._eyes[number]) is None or eye.ring.latest == seen:
                    if connection.state is not State.OPEN:
                        return
                    await asyncio.sleep(GLANCE)
                if note != self._note:
                    note = self._note
                    await connection.send(note)
                seen, true_ns, jpeg = await asyncio.to_thread(eye.jpeg)
                age, waited = 1e-6 * (time.monotonic_ns() - true_ns), time.monotonic() - since
                head = PICTURE.pack(seen & 0xFFFFFFFF, age, 1e3 * waited)
                await connection.send(head + jpeg)
        finally:
            self._looking -= 1

    async def _ask(self, connection: ServerConnection, clock: Clock) -> None:
        with suppress(ConnectionClosed):
            while True:
                await connection.send(clock.ask())
                await asyncio.sleep(EVERY)

    def _take(self, data: str | bytes, clock: Clock) -> None:
        now = time.monotonic_ns()
        try:
            if isinstance(data, str):
                raise Refused("text")
            if len(data) == ANSWER.size:
                clock.answer(data)
                return
            frame = Frame(data)
            if frame.number <= self._number:
                raise Refused("not in order")
            stamp = clock.at(frame.time)
            if stamp is None:
                return
            late = 1e-9 * (now - stamp)
            if abs(late) > self._stale:
                raise Refused("too late")
        except Refused as why:
            self._refuse(str(why))
            return
        if self._number >= 0:
            self._missed += frame.number - self._number - 1
        self._number, self._heard = frame.number, time.monotonic()
        self._tell(frame, min(stamp, now), max(late, 0.0))

    def _tell(self, frame: Frame, stamp: int, late: float) -> None:
        name = self._feed.name
        told: AnyDict = {
            part: frame.poses[at if at.stop - at.start > 1 else at.start]
            for part, at in PARTS.items()
        }
        for row, side in enumerate(("left", "right")):
            told |= {f"{side}_buttons": frame.buttons[row], f"{side}_axes": frame.axes[row]}
        told |= {"valid": frame.valid, "latency": late, "number": frame.number}
        told |= {"missed": self._missed, "refused": self._refused}
        self._feed.publish(stamp, **{f"{name}_{word}": value for word, value in told.items()})

    def _refuse(self, why: str) -> None:
        self._refused += 1
        if why not in self._why:
            self._why.add(why)
            self._feed.tell(f"{self._feed.name}: refused: {why}; all such are counted")

    def close(self) -> None:
        """Serve nobody any more."""
        self._server.close()
        with suppress(Exception):
            self._loop.run_until_complete(asyncio.wait_for(self._server.wait_closed(), 1.0))


if __name__ == "__main__":
    end(serve(WebXr))
