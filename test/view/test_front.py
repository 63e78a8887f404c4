"""The door of a viewer's server: who is silent keeps nobody out."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from unicon_ros.web_front import CLIENTS, Front

ANSWER = b"HTTP/1.1 200 OK\r\n\r\n"


@pytest.fixture
def front() -> Iterator[Front]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        kept: list[socket.socket] = []

        def answers() -> None:
            while True:
                try:
                    client, _ = server.accept()
                except OSError:
                    return
                client.sendall(ANSWER)
                kept.append(client)

        threading.Thread(target=answers, daemon=True).start()
        made = Front("127.0.0.1", 0, server.getsockname())
        yield made
        made.close()
        server.shutdown(socket.SHUT_RDWR)
        for client in kept:
            client.close()


def asks(front: Front) -> tuple[socket.socket, bytes]:
    client = socket.create_connection(("127.0.0.1", front.port), 3.0)
    client.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{front.port}\r\n\r\n".encode())
    return client, client.recv(200)


def test_clients_who_say_nothing_keep_nobody_out(front: Front) -> None:
    silent = [socket.create_connection(("127.0.0.1", front.port)) for _ in range(2 * CLIENTS)]
    client, told = asks(front)
    assert told == ANSWER
    for each in [*silent, client]:
        each.close()


def test_no_more_come_in_than_there_is_room_for(front: Front) -> None:
    inside = [asks(front) for _ in range(CLIENTS)]
    assert {told for _, told in inside} == {ANSWER}
    late, told = asks(front)
    assert told.endswith(b"too many are here")
    for each in [late, *(client for client, _ in inside)]:
        each.close()
