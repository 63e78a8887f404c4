"""Access: where a page may be served, and which browsers may look."""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from urllib.parse import urlsplit

from unicon_core.errors import UniconError

__all__ = ["LOOPBACK", "check_reach", "refusal"]

LOOPBACK = ("127.0.0.1", "localhost", "::1")

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
