"""Services of type std_srvs/srv/Trigger, for whatever a node lets others do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["Answer", "add_services", "explained"]

Answer = tuple[bool, str]
"""Success, and a line for the caller."""


def add_services(
    node: Any, handlers: dict[str, Callable[[], Answer]], warn: Callable[[str], object]
) -> list[Any]:
    """Create `~/<name>` of type std_srvs/srv/Trigger for each handler; return the services.

    A handler that raises is answered with the reason: a mistake of ours must not end a node.
    """
    from std_srvs.srv import Trigger

    def callback(name: str, handler: Callable[[], Answer]) -> Callable[[Any, Any], Any]:
        def answer(_: Any, response: Any) -> Any:
            try:
                response.success, response.message = handler()
            except Exception as error:
                response.success, response.message = False, f"~/{name} failed: {explained(error)}"
                warn(response.message)
            return response

        return answer

    return [
        node.create_service(Trigger, f"~/{name}", callback(name, handler))
        for name, handler in handlers.items()
    ]


def explained(error: BaseException) -> str:
    """Return an unexpected exception as one line: its kind and what it says."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
