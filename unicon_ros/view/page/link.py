"""Link: the line to one browser, and who may have one; where viser has no word for it.

viser has no heartbeat, no gamepad, no origin check and no token. What is used of its inside stands
here alone, and setup.py holds its version. A page answers the question for one key of the browser's
storage as soon as it has handled whatever was sent before it: that is the acknowledgement of a
picture, the heartbeat, and with our script (`script.js`) the state of gamepad and keys.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import time
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

from viser import _messages

from unicon_core.errors import UniconError

__all__ = ["LOOPBACK", "Link", "check_reach", "opened", "refusal"]

LOOPBACK = ("127.0.0.1", "localhost", "::1")

KEY = "unicon"
"""Of the storage that `script.js` answers for."""

_SHORTEST = 8  # characters of a token


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
        heard: is given the page's state with each answer, in another thread.
        stop: viser's button behind the large one, None where there is nothing to stop.

    Attributes:
        asked, answered: questions so far.
        last: when the page answered last, of `time.monotonic`.
    """

    def __init__(self, client: Any, heard: Callable[[dict[str, Any]], None], stop: Any) -> None:
        self._connection, self._heard, self._client = client._websock_connection, heard, client
        self.asked = self.answered = 0
        self.last = time.monotonic()
        self._connection.register_handler(
            _messages.LocalStorageGetItemResponseMessage, self._answer
        )
        script = files(__package__).joinpath("script.js").read_text()
        given = json.dumps({"key": f"viser-user:{KEY}", "stop": stop and stop._impl.uuid})
        self._connection.queue_message(
            _messages.RunJavascriptMessage(source=f"const given = {given};\n{script}")
        )

    @property
    def pending(self) -> int:
        """Questions that the page has not answered."""
        return self.asked - self.answered

    def ask(self) -> None:
        """Ask the page whether it has handled all that was sent so far."""
        self.asked += 1
        self._connection.queue_message(
            _messages.LocalStorageGetItemRequestMessage(key=KEY, request_uuid=str(self.asked))
        )

    def _answer(self, _: int, message: Any) -> None:
        try:
            number = int(message.request_uuid)
            state = json.loads(message.value or "{}")
        except ValueError:
            return
        if not self.answered < number <= self.asked or not isinstance(state, dict):
            return
        self.answered, self.last = number, time.monotonic()
        self._heard(state)
