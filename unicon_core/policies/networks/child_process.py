"""Process of a network in a child: answers what the parent asks; started by `ChildNetwork`.

It reads the contract from stdin, then one line that says to what it is bound; stdin's end asks it
to end. It ends, too, when its parent has died, and when a call hangs.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import suppress
from typing import Any

import numpy as np

from unicon_base.errors import UniconError
from unicon_core.platforms.child.pipe import ALARM, LONGEST, Parent, text_of
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks import Remembering, open_network
from unicon_core.policies.networks.child import ANSWER, QUESTION, START
from unicon_core.states import Layout, States
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter

# How often it looks whether its parent lives while nothing is asked, in [s].
_LOOK = 0.005


def main() -> int:
    """Run; 0 after an orderly end, 3 after a fault."""
    parent = Parent(START)
    contract: PolicyContract = parent.given["contract"]
    try:
        warnings = _prepare(contract)
        network = open_network(contract)
        parent.tell(inputs=network.inputs, outputs=network.outputs, warnings=warnings)
        answering = _answering(parent, network)
    except UniconError as error:
        parent.tell(error=str(error)[:LONGEST], kind=type(error).__name__)
        return 1
    except Exception as error:
        parent.tell(
            error=f"policy {contract.name!r}: its process raised {text_of(error)}",
            kind="PolicyError",
        )
        return 1
    if answering is None:
        return 0
    try:
        answering.run(parent)
    except Exception as error:
        parent.tell(fault=f"policy {contract.name!r}: its process raised {text_of(error)}")
        return 3
    return 0


def _prepare(contract: PolicyContract) -> list[str]:
    """Go to the core that is wished; return what was refused."""
    assert contract.child is not None
    with suppress(OSError):  # being woken, it takes no core from the tick that woke it
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    cpu = contract.child.cpu
    if cpu is None:
        return []
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, AttributeError) as error:
        last = (os.cpu_count() or 1) - 1
        refused = f"core {cpu} refused ({error}); known: 0 to {last} (child.cpu)"
        return [f"policy {contract.name!r}: {refused}"]
    return []


def _answering(parent: Parent, network: Any) -> _Answering | None:
    """Bind the network as the parent says; None where it closes before."""
    while True:
        signal.alarm(round(START) + ALARM)
        wishes = parent.wishes()
        if wishes is None:
            return None
        for _, *given in wishes:
            answering = _Answering(network, *given)
            parent.tell(bound=True)
            return answering
        time.sleep(0.001)


class _Answering:
    """The network between both segments."""

    def __init__(
        self,
        network: Any,
        parent: str,
        name: str,
        inputs: list[str],
        outputs: list[str],
        questions: str,
        answers: str,
    ) -> None:
        asked, told = States(Layout.from_json(questions)), States(Layout.from_json(answers))
        self._call = network.bind(
            {tensor: asked[f"x{i}"] for i, tensor in enumerate(inputs)},
            {tensor: told[f"y{i}"] for i, tensor in enumerate(outputs)},
        )
        self._keeps = isinstance(self._call, Remembering)
        self._call()  # the first call takes longest
        self._number, self._fresh = asked["number"], asked["fresh"]
        self._answered = told["number"]
        self._reader = ShmReader(parent, QUESTION, asked)
        self._reader.unlink()  # nothing is left of a parent that is killed from here on
        self._segment = Segment.create(name, {ANSWER: told.layout})
        self._writer = ShmWriter(self._segment, ANSWER, told)

    def run(self, parent: Parent) -> None:
        """Answer until the parent closes or dies."""
        reader, call, looked = self._reader, self._call, 0.0
        with np.errstate(all="ignore"):
            while True:
                signal.alarm(ALARM)  # the kernel ends a call that hangs, also without a parent
                if reader.wait(_LOOK) and reader.take():
                    if self._keeps and self._fresh:
                        call.reset()
                    call()
                    if self._keeps:
                        call.commit()
                    self._answered[...] = self._number
                    self._writer.publish()
                now = time.monotonic()
                if now - looked > _LOOK:
                    looked = now
                    if parent.wishes() is None or not reader.alive():
                        return


if __name__ == "__main__":
    # No destructors: runtimes' libraries print tracebacks when Python tears them down.
    status = main()
    sys.stderr.flush()
    os._exit(status)
