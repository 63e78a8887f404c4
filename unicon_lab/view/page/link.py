"""PageConnection: the line to one browser, where viser has no word for it.

viser has no heartbeat, no gamepad, no origin check and no token. What is used of its inside stands
here alone, and setup.py holds its version. A page answers the question for one key of the browser's
storage as soon as it has handled whatever was sent before it: that is the acknowledgement of a
picture. Our script in the page (`script.js`) tells 10 times a second that it lives, whatever the
pictures take, and at once what gamepad and keys do: as the text of a widget that nobody sees.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.resources import files
from typing import Any

from viser import _messages

KEY = "unicon"
"""Of the storage; nothing is kept there."""

_TEXT = 1000  # characters of a heartbeat: a gamepad's name is the longest part
_LONGEST = 0.15  # [s] that one picture counts: the first is the whole scene


def opened(server: Any, client: Any) -> tuple[Mapping[str, str], str]:
    """Return headers and path of the request that opened a client's websocket."""
    connection = server._websock_server._live_connections.get(client.client_id)
    if connection is None or connection.request is None:
        return {}, ""
    return connection.request.headers, connection.request.path


def drop(server: Any, number: int) -> None:
    """Close the websocket of a client, by its number."""
    connection = server._websock_server._live_connections.get(number)
    if connection is not None:
        asyncio.run_coroutine_threadsafe(connection.close(1008, "refused"), server.get_event_loop())


def guard(server: Any, refused: Callable[[Any], str]) -> None:
    """Let a server close each websocket at its opening that is refused.

    Args:
        server: viser's.
        refused: is given a connection with `client_id`; returns why not, "" to let it in.
    """

    async def look(connection: Any) -> None:
        if refused(connection):
            await server._websock_server._live_connections[connection.client_id].close(
                1008, "refused"
            )

    server._websock_server.on_client_connect(look)


def close_doors(server: Any) -> None:
    """Take from a server what would ask a foreign host: its share button's tunnel."""
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)


def move(node: Any, position: Sequence[float], quat: Sequence[float] | None = None) -> None:
    """Put a node of a scene where it has moved to.

    Its own properties compare with what was there, which took half of a viewer's time.

    Args:
        node: viser's handle.
        position: in its parent in [m], three numbers.
        quat: likewise, wxyz; None where it never turns.
    """
    inside = node._impl
    queue = inside.api._queue_scene_message
    queue(_messages.SetPositionMessage(inside.name, tuple(position)))
    if quat is not None:
        queue(_messages.SetOrientationMessage(inside.name, tuple(quat)))


class PageConnection:
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
    if len(text) > _TEXT:
        return None
    try:
        state = json.loads(text.partition(" ")[2])
    except ValueError:
        return None
    return state if isinstance(state, dict) else None
