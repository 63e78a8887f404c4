"""Sockets of a message queue (addresses, bounds, keys), and which of their values may pass.

One live sender passes, in order, and not late. Clocks of two machines differ, so that nobody can
tell how long a value was under way; by how much longer than the fastest one, everybody can. The
smallest (arrival − sent) of a sender is its offset. After a cut link TCP delivers what it kept, in
order and whole, and only the offset tells it from news.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import socket as sockets
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unicon_base.errors import MissingDependencyError, StateError

WITHOUT_KEYS = "anybody who reaches it may read there, or write where a reader is bound"

HEARTBEAT = 0.5
PATIENCE = 2.0
"""s until a peer that answers no heartbeat, handshake or connection is given up and tried anew."""

RECONNECT = 0.1  # s between two tries
LOOKS = 16
"""Messages that are looked at in one go: with more writers than that, all wrong, a good value may
wait for the next go, and no tick waits for a flood."""
KEPT = 8  # messages of a dialogue that wait at each end
BUFFER = 1 << 16
"""B that the kernel keeps on the way, at least: more of it is only older values after a cut."""


def is_exposed(address: str) -> bool:
    """Return whether other machines can reach an address; a name counts, but for `localhost`."""
    host = address.removeprefix("tcp://").rpartition(":")[0].strip("[]")
    if not address.startswith("tcp://") or host == "localhost":
        return False
    try:
        return not ipaddress.ip_address(host).is_loopback
    except ValueError:  # a name, or `*`
        return True


def _zmq(what: str) -> Any:
    try:
        import zmq
    except ImportError as error:
        install = "pip install 'unicon_ros[zmq]' (or: sudo apt install python3-zmq)"
        raise MissingDependencyError(what, "pyzmq", install) from error
    return zmq


class Endpoint:
    """One end of a PUB/SUB pair which keeps the newest message only, or of a dialogue which keeps
    `KEPT` of them; a context of its own.

    Args:
        what: for messages: whose end it is.
        address: `tcp://host:port` or `ipc://path`; `tcp://127.0.0.1:*` binds a free port.
        publish: the PUB end, else the SUB end; None: of a dialogue, ROUTER where it binds, else
            DEALER. Nobody is waited for: what a peer does not take in time is dropped.
        bind: be there for others, else go to where another end is bound.
        size: of a message, [B]; of a dialogue the largest that is taken.
        keys: folder with CURVE keys, or None: anybody who reaches the address may join.
        without_keys: listen without keys where other machines reach the address, too.

    Attributes:
        zmq: the module.
        socket: of ZeroMQ.
        address: where it is bound, with the port.
        key: public key of this end, "" without keys.

    Raises:
        MissingDependencyError: pyzmq is not installed.
        StateError: the address cannot be had, a key is missing, or other machines would reach an
            end that listens without keys.
    """

    def __init__(
        self,
        what: str,
        address: str,
        *,
        publish: bool | None,
        bind: bool,
        size: int,
        keys: str | Path | None,
        without_keys: bool = False,
    ) -> None:
        self.zmq = zmq = _zmq(what.partition(",")[0])
        port = str(address).removeprefix("tcp://").rpartition(":")[2]  # zmq takes it modulo 2^16
        tall = str(address).startswith("tcp://") and port.isdigit() and int(port) > 65535
        if tall or not str(address).startswith(("tcp://", "ipc://")):
            raise StateError(
                f"{what}: {address!r} is not an address; give tcp://HOST:PORT or ipc://PATH"
            )
        if bind and keys is None and not without_keys and is_exposed(address):
            raise StateError(
                f"{what}: {address} listens beyond this machine without keys: {WITHOUT_KEYS}; "
                "give keys=FOLDER (docs/howto/zmq.md), an address of 127.0.0.1 or ipc://, or "
                "without_keys=True"
            )
        self.key = ""
        self._guard: Any = None
        self._failures: Any = None
        self._file: tuple[str, int] | None = None  # and its inode
        self._context = zmq.Context()
        talks = zmq.ROUTER if bind else zmq.DEALER
        kind = talks if publish is None else zmq.PUB if publish else zmq.SUB
        self.socket = self._context.socket(kind)
        options = {
            zmq.LINGER: 0,
            zmq.HEARTBEAT_IVL: round(HEARTBEAT * 1e3),
            zmq.HEARTBEAT_TIMEOUT: round(PATIENCE * 1e3),
            zmq.HANDSHAKE_IVL: round(PATIENCE * 1e3),
            zmq.CONNECT_TIMEOUT: round(PATIENCE * 1e3),
            zmq.RECONNECT_IVL: round(RECONNECT * 1e3),
        }
        if publish is None:  # what cannot be sent at once is old when somebody is there
            own = {zmq.IMMEDIATE: 1, zmq.SNDHWM: KEPT, zmq.RCVHWM: KEPT, zmq.MAXMSGSIZE: size}
        else:
            own = {
                zmq.CONFLATE: 1,
                zmq.SNDBUF if publish else zmq.RCVBUF: max(BUFFER, 4 * size),
                # Subscriptions are short; a longer message than ours may be another layout's.
                zmq.MAXMSGSIZE: BUFFER if publish else 4 * size + (1 << 20),
            }
        try:
            for option, value in (options | own).items():
                self.socket.setsockopt(option, value)
            if publish is False:
                self.socket.setsockopt(zmq.SUBSCRIBE, b"")
            if keys is not None:
                self._secure(what, Path(keys), bind)
            if not bind:
                failed = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_AUTH
                self._failures = self.socket.get_monitor_socket(failed)
            self._open(address, bind)
        except zmq.ZMQError as error:
            self.close()
            known = error.errno in errno.errorcode  # pyzmq's own text repeats the address
            reason = os.strerror(error.errno).lower() if known else str(error)
            raise StateError(f"{what}: {address}: {reason}; {_remedy(bind)}") from error
        except BaseException:
            self.close()
            raise
        self.address = self.socket.getsockopt(zmq.LAST_ENDPOINT).decode().rstrip("\0")

    def _open(self, address: str, bind: bool) -> None:
        if not bind:
            self.socket.connect(address)
            return
        path = address.removeprefix("ipc://")
        is_file = address.startswith("ipc://") and not path.startswith("@")
        if is_file and _answers(path):  # it would be taken from its server, without a word
            raise self.zmq.ZMQError(self.zmq.EADDRINUSE)
        self.socket.bind(address)
        if is_file:
            with suppress(OSError):  # it has gone again
                os.chmod(path, 0o600)
                self._file = path, os.stat(path).st_ino

    def send(self, parts: list[Any]) -> None:
        """Send a message of a dialogue; drop it where nobody is there, or has room for it."""
        with suppress(self.zmq.ZMQError):
            self.socket.send_multipart(parts, self.zmq.NOBLOCK)

    def received(self) -> Iterator[list[bytes]]:
        """Yield the messages of a dialogue that have come, at most `LOOKS`."""
        with suppress(self.zmq.Again):
            for _ in range(LOOKS):
                yield self.socket.recv_multipart(self.zmq.NOBLOCK)

    def rejoin(self) -> None:
        """Connect anew where somebody without our keys was at the address.

        libzmq does not try again after a handshake that was not its own (`session_base_t::
        engine_error` of libzmq 4.3: a protocol error ends the session).
        """
        failures = self._failures
        if failures is None or not failures.poll(0):
            return
        with suppress(self.zmq.Again):
            while True:
                failures.recv_multipart(self.zmq.NOBLOCK)
        with suppress(self.zmq.ZMQError):  # the session has ended
            self.socket.disconnect(self.address)
        self.socket.connect(self.address)

    def _secure(self, what: str, folder: Path, bind: bool) -> None:
        """Take keys: who binds has `server.key_secret` and knows its peers, `clients/*.key`; who
        connects has `client.key_secret` and knows `server.key`."""
        if not self.zmq.has("curve"):
            raise StateError(f"{what}: this pyzmq has no CURVE; install one with libsodium")
        from zmq import auth
        from zmq.auth.thread import ThreadAuthenticator

        own = folder / ("server.key_secret" if bind else "client.key_secret")
        theirs = [folder / "server.key"] if not bind else sorted((folder / "clients").glob("*.key"))
        if not theirs:
            raise StateError(f"{what}: no keys of peers in {folder / 'clients'}; {_KEYS}")
        loaded = {}
        for path in (own, *theirs):
            try:
                loaded[path] = auth.load_certificate(path)
            except (OSError, ValueError) as error:
                raise StateError(f"{what}: {path} is not a key file; {_KEYS}") from error
        public, secret = loaded[own]
        if secret is None:
            raise StateError(f"{what}: {own} holds no secret key; {_KEYS}")
        try:
            self.socket.curve_publickey, self.socket.curve_secretkey = public, secret
            self.key = public.decode()
            if not bind:
                self.socket.curve_serverkey = loaded[theirs[0]][0]
        except self.zmq.ZMQError as error:
            raise StateError(f"{what}: a key in {folder} is damaged; {_KEYS}") from error
        if bind:
            self.socket.curve_server = True
            self._guard = ThreadAuthenticator(self._context)
            self._guard.start()
            self._guard.configure_curve(domain="*", location=str(folder / "clients"))

    def close(self) -> None:
        """Let go; safe to call twice."""
        if self._guard is not None:
            self._guard.stop()
            self._guard = None
        if self._failures is not None:
            self.socket.disable_monitor()
            self._failures.close(linger=0)
            self._failures = None
        self.socket.close(linger=0)
        self._context.term()
        if self._file is not None:
            path, inode = self._file
            with suppress(OSError):
                if os.stat(path).st_ino == inode:  # libzmq leaves it
                    os.unlink(path)
            self._file = None


_KEYS = "make keys with zmq.auth.create_certificates (docs/howto/zmq.md)"


def _remedy(bind: bool) -> str:
    if bind:
        return "end what has it, give another address, or let this end connect"
    return "give the address where the other end is bound"


def _answers(path: str) -> bool:
    """Return whether somebody is bound to the socket of a path."""
    probe = sockets.socket(sockets.AF_UNIX)
    probe.settimeout(1.0)
    try:
        probe.connect(path)
    except OSError:
        return False
    finally:
        probe.close()
    return True


SILENCE = 0.5
"""s without a value after which a sender is not live any more, and another one may follow it."""

SETTLE = 0.05
"""s for which a sender is watched before its values pass: the first one tells nothing of its age,
and what a link has kept comes at once."""

STEADY = 1000
"""Time in which an offset grows by one, while no value is as fast: both clocks may be slewed by
500 ppm (adjtimex(2)), and a minimum that is kept for ever would make every value late in the end.
The price: a link that is slower for good is refused for minutes, then taken as it is."""


@dataclass
class _Sender:
    """One start of a writer; times in [ns], `sent` of its clock, the others of ours."""

    epoch: int
    first: int
    number: int
    sent: int
    offset: int
    at: int  # when the offset was brought up to date
    fresh_at: int = 0  # when its newest value came that was not late

    def live(self, now: int) -> bool:
        return now - self.fresh_at < SILENCE * 1e9


class Freshness:
    """Judges the values of one group, each told by epoch, number and times.

    Args:
        late: by how much longer than the fastest a value may take, [s].

    Attributes:
        delay: by how much longer the value took that passed last, [ns].
        late, reordered, rivals: values that did not pass: they took too long; they came again or
            in another order; they are of another sender while one lives.
        skipped: values that nobody looked at, because newer ones had come.
        lost: values that had not come when they were late and somebody looked; reckoned at an even
            rate, since only the next value tells of them.
    """

    def __init__(self, late: float) -> None:
        self._longest = round(late * 1e9)
        self._present: _Sender | None = None
        self._other: _Sender | None = None  # the one before, or one that waits
        self._looked = 0
        self.delay = self.late = self.reordered = self.rivals = self.skipped = self.lost = 0

    def nothing(self, now: int) -> None:
        """Note that there was nothing to be seen."""
        self._looked = now

    def live(self, now: int) -> bool:
        """Return whether the present sender lives."""
        return self._present is not None and self._present.live(now)

    def passes(self, epoch: int, number: int, sent: int, now: int) -> bool:
        """Judge a value that has just been seen.

        Args:
            epoch: of the sender.
            number: of the value, from 1.
            sent: when, by the sender's clock, [ns].
            now: by our clock, [ns].
        """
        sender = self._present
        if sender is None or sender.epoch != epoch:
            sender = self._another(epoch, number, sent, now)
        if sender is None:
            self.rivals += 1
            return False
        if number <= sender.number or sent < sender.sent:
            self.reordered += 1
            return False
        way, offset = now - sent, sender.offset + (now - sender.at) // STEADY
        if way < offset:
            offset = way
        sender.offset, sender.at, delay = offset, now, way - offset
        if number != sender.number + 1 and sender is self._present:
            self._count_gap(sender, number, sent)
        sender.number, sender.sent = number, sent
        if delay > self._longest:
            self.late += 1
            return False
        sender.fresh_at = now
        if sender is not self._present:
            if self.live(now):
                self.rivals += 1
                return False
            if now - sender.first < SETTLE * 1e9:
                return False
            # The one before is remembered: what it sent may still come, late.
            self._present, self._other = sender, self._present
        self.delay = delay
        return True

    def _another(self, epoch: int, number: int, sent: int, now: int) -> _Sender | None:
        """Return who sent it, not the present one; None where one more is live already."""
        other = self._other
        if other is not None and other.epoch == epoch:
            return other
        if other is not None and other.live(now):
            return None
        self._other = _Sender(epoch, now, number - 1, sent, now - sent, now)
        return self._other

    def _count_gap(self, sender: _Sender, number: int, sent: int) -> None:
        missing = number - sender.number - 1
        due = self._looked - self._longest - sender.offset  # what was sent before was lost
        share = min(max((due - sender.sent) / max(sent - sender.sent, 1), 0.0), 1.0)
        lost = int(missing * share)
        self.lost += lost
        self.skipped += missing - lost
