"""Link: the line to one browser, and who may have one; where viser has no word for it.

viser has no heartbeat, no gamepad, no origin check and no token. What is used of its inside stands
here alone, and setup.py holds its version. A page answers the question for one key of the browser's
storage as soon as it has handled whatever was sent before it: that is the acknowledgement of a
picture. Our script in the page (`script.js`) tells 10 times a second that it lives, whatever the
pictures take, and at once what gamepad and keys do: as the text of a widget that nobody sees.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

from viser import _messages

from unicon_core.errors import UniconError

__all__ = ["LOOPBACK", "Link", "check_reach", "opened", "refusal", "state_of"]

LOOPBACK = ("127.0.0.1", "localhost", "::1")

KEY = "unicon"
"""Of the storage; nothing is kept there."""

_SHORTEST = 8  # characters of a token
_LONGEST = 0.15  # [s] that one picture counts: the first is the whole scene


def check_reach(host: str, token: str) -> None:
    """Refuse a page that everybody in the network could drive from.

    Raises:
        UniconError: a host beyond this machine without a token, or a token that is none.
    """
    if token and (len(token) < _SHORTEST or not token.isascii() or not token.isalnum()):
        raise UniconError(
            f"--view-token {token!r} is not a token; give {_SHORTEST} or more letters and digits"
        )
    if host not in LOOPBACK and not token:
        raise UniconError(
            f"--view-host {host} lets everybody in the network drive the robot; add --view-token "
            "TOKEN, or leave --view-host out and come through ssh -L"
        )


def refusal(headers: Mapping[str, str], path: str, token: str) -> str:
    """Return why a browser may not look, "" where it may.

    Another site's page, open in the same browser, can reach 127.0.0.1 too: it tells its own origin,
    or, where it had its name point here, a host that is not this one.

    Args:
        headers: of the request that opens the websocket.
        path: of that request; `/TOKEN` where one is needed.
        token: "" for none.
    """
    host, origin = headers.get("Host", ""), headers.get("Origin")
    try:
        name = urlsplit(f"//{host}").hostname or ""
        site = urlsplit(origin).netloc if origin else host
    except ValueError:
        return "its address cannot be read"
    if token:
        given = path.strip("/").encode(errors="replace")
        if not hmac.compare_digest(given, token.encode()):
            return "it does not know the token"
    elif name not in LOOPBACK:
        return f"it asks for host {name!r}"
    return "" if site == host else f"it is a page of {origin}"


def opened(server: Any, client: Any) -> tuple[Mapping[str, str], str]:
    """Return headers and path of the request that opened a client's websocket."""
    connection = server._websock_server._live_connections.get(client.client_id)
    if connection is None or connection.request is None:
        return {}, ""
    return connection.request.headers, connection.request.path


def drop(server: Any, client: Any) -> None:
    """Close a client's websocket."""
    connection = server._websock_server._live_connections.get(client.client_id)
    if connection is not None:
        closing = connection.close(1008, "refused")
        asyncio.run_coroutine_threadsafe(closing, server.get_event_loop())


def close_doors(server: Any) -> None:
    """Take from a server what would ask a foreign host: its share button's tunnel."""
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)


class Link:
    """The line to one page.

    Args:
        client: viser's handle.
        heard: is given what the page tells of itself, in another thread.
        stop: viser's button behind the large one, None where there is nothing to stop.

    Attributes:
        asked, answered: pictures sent, and those that the page has handled.
        takes: how long it takes of late to have one handled, in [s].
    """

    def __init__(self, client: Any, heard: Callable[[dict[str, Any]], None], stop: Any) -> None:
        self._connection = client._websock_connection
        self.asked = self.answered = 0
        self.takes = self._sent = 0.0
        self._connection.register_handler(
            _messages.LocalStorageGetItemResponseMessage, self._answer
        )
        beat = client.gui.add_text("heartbeat", "", visible=False)

        @beat.on_update
        async def _(_: Any) -> None:
            state = state_of(beat.value)
            if state is not None:
                heard(state)

        uuids = {"stop": stop and stop._impl.uuid, "beat": beat._impl.uuid}
        script = files(__package__).joinpath("script.js").read_text(encoding="utf-8")
        self._connection.queue_message(
            _messages.RunJavascriptMessage(source=f"const given = {json.dumps(uuids)};\n{script}")
        )

    @property
    def pending(self) -> int:
        """Pictures that the page has not handled yet."""
        return self.asked - self.answered

    def ask(self) -> None:
        """Ask the page to answer when it has handled all that was sent so far."""
        self.asked += 1
        self._sent = time.monotonic()
        self._connection.queue_message(
            _messages.LocalStorageGetItemRequestMessage(key=KEY, request_uuid=str(self.asked))
        )

    def _answer(self, _: int, message: Any) -> None:
        with suppress(ValueError):
            number = int(message.request_uuid)
            if self.answered < number <= self.asked:
                self.answered = number
                took = min(time.monotonic() - self._sent, _LONGEST)
                self.takes += 0.4 * (took - self.takes)


def state_of(text: str) -> dict[str, Any] | None:
    """Return what a heartbeat tells, None for garbage.

    Args:
        text: a number, a blank, and a JSON object: `hidden`, `stops` (presses of the e-stop), `pad`
            (name) and `device`, three numbers from -1 to 1 for vx, vy and wz.
    """
    try:
        state = json.loads(text.partition(" ")[2])
    except ValueError:
        return None
    return state if isinstance(state, dict) else None
