"""Services of type std_srvs/srv/Trigger, for whatever a node lets others do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unicon_core.blocks.controls.modes import Skills
from unicon_core.workflow import Program
from unicon_core.workflow.skills import skills_of
from unicon_ros.controls import Answer

SERVICES = {
    "start": "the operator's go; continues after a pause; configures and activates an idle node",
    "stop": "ends the run after the current tick: shutdown sequence, then damping",
    "estop": "stops before the next command, damps, counts as a fault, and latches",
    "clear_estop": "clears that latch after the run has ended",
    "reset": "resets a simulator and the flow",
    "pause": "pauses a simulator until `~/start` or `~/step`",
    "step": "runs one tick of a paused simulator",
    "list_states": "returns the JSON of `~/layout`",
}
"""Each `~/<name>`, and what it does."""


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


def skill_handlers(program: Program, runs: Callable[[], bool]) -> dict[str, Callable[[], Answer]]:
    """Return `skills/NAME` for each skill of a workflow, which asks for it.

    Args:
        program: the workflow.
        runs: tells whether it ticks.
    """
    skills = skills_of(program)

    def asking(skills: Skills, name: str) -> Callable[[], Answer]:
        def ask() -> Answer:
            if not runs():
                return False, "nothing runs"
            reason = skills.ask(name)
            told = f"{name} from the next tick on" if skills.now != name else "it runs already"
            return not reason, f"refused: {reason}" if reason else told

        return ask

    return {} if skills is None else {f"skills/{n}": asking(skills, n) for n in skills.names}


def explained(error: BaseException) -> str:
    """Return an unexpected exception as one line: its kind and what it says."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
