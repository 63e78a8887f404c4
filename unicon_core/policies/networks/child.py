"""The network of a policy in a process of its own: the parent's end, and the child.

The child reads the contract from stdin, then one line that says to what it is bound; stdin's end
asks it to end. It ends, too, when its parent has died, and when a call hangs.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from unicon_base.arrays import Array, Float64
from unicon_base.errors import Fault, PolicyError, UniconError
from unicon_core.platforms.child.pipe import ALARM, LONGEST, Parent, Pipe, text_of
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks import Remembering, open_network
from unicon_core.policies.networks.onnx_file import Arrays, Tensor
from unicon_core.policies.remote_spec import ChildSpec
from unicon_core.signals import SIGNALS
from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter, remove_dead

QUESTION, ANSWER = "question", "answer"
"""Groups of the two segments."""

START = 120.0
"""Longest time to start in [s]: large networks are read and optimized."""

PATIENCE = 10.0
"""Longest wait for an answer in [s], where it is waited for."""

# How long the child may take to end in [s]; it holds no motor and is killed then.
_CLOSING = 1.0

# How often each looks whether the other lives, in [s].
_LOOK = 0.005

_MODULE = "unicon_core.policies.networks.child"


class ChildNetwork:
    """The network of a contract in a process of its own, as if it were here.

    What it takes goes there and what it gives comes back through shared memory
    (`states/backends/shm/`); neither waits for the other, except `take` where it is asked to. The
    child keeps nothing but the network: what is fed back comes with each call, so that an answer
    to a question that was dropped leaves no trace. Both segments are laid out by the first arrays
    that it is bound to.

    Args:
        contract: the policy; with `child`, which says how it runs there.

    Attributes:
        inputs, outputs: tensors of the network.
        process: the child.
        key: of the workflow's options.
        culprit: what has to answer, for messages.
        measured: states of the policy that the network gives beside its outputs.

    Raises:
        UniconError: what was raised there when the network was loaded.
        PolicyError: the child did not start.
    """

    key = "child"
    measured: Mapping[str, Array] = {}

    def __init__(self, contract: PolicyContract) -> None:
        self.what = f"policy {contract.name!r}"
        self.number = 0
        self._closed = False
        self._names: tuple[tuple[str, ...], ...] = ()
        self._segment: Segment | None = None
        self._reader: ShmReader | None = None
        self._child_segment = ""
        self.pipe = Pipe(self.what, {"contract": contract}, _MODULE)
        self.process = self.pipe.process
        self.culprit = f"its process {self.process.pid}"
        try:
            reply = self.pipe.answer(START, SIGNALS.check)
        except BaseException:
            self.close()
            raise
        self.inputs: tuple[Tensor, ...] = reply["inputs"]
        self.outputs: tuple[Tensor, ...] = reply["outputs"]
        self.warnings: list[str] = reply["warnings"]

    def bind(self, inputs: Arrays, outputs: Arrays) -> Question:
        """Return what asks the child about these arrays, and brings its answers into them.

        Raises:
            UniconError: the network cannot be bound to them.
            PolicyError: it has been bound to arrays of other shapes.
        """
        names, layouts = (tuple(inputs), tuple(outputs)), layouts_of(inputs, outputs)
        if not self._names:
            self._names, self._layouts = names, layouts
            try:
                self._open()
            except BaseException:
                self._release()
                self._names = ()
                raise
        if (names, layouts) != (self._names, self._layouts):
            raise PolicyError(
                f"{self.what}: its network in a child is bound to other sizes already; "
                "leave out child"
            )
        return Question(self, list(inputs.values()), list(outputs.values()))

    def _open(self) -> None:
        self.questions, self.answers = map(States, self._layouts)
        name = f"policy-{os.getpid()}-{id(self) & 0xFFFF:x}"
        self._child_segment = f"{name}-child"
        self._segment = Segment.create(name, {QUESTION: self.questions.layout})
        self.writer = ShmWriter(self._segment, QUESTION, self.questions)
        layouts = (layout.to_json() for layout in self._layouts)
        self.pipe.tell("bind", name, self._child_segment, *map(list, self._names), *layouts)
        self.pipe.answer(START, SIGNALS.check)
        self._reader = ShmReader(self._child_segment, ANSWER, self.answers)
        self._segment.unlink()  # nobody else is to find them
        self._reader.unlink()

    def receive(self) -> None:
        """Look once a tick, whether an answer is due or not."""

    def look(self) -> None:
        """Look while an answer is awaited.

        Raises:
            Fault: none will come.
        """
        if self.process.poll() is not None:
            raise Fault(self.pipe.words().get("fault") or self.pipe.end)

    def latency(self) -> dict[str, Float64]:
        """Return times of answers in [ms] by name, for the report of a run; {} for none."""
        return {}

    @property
    def reader(self) -> ShmReader:
        """What takes answers."""
        assert self._reader is not None
        return self._reader

    def close(self) -> None:
        """End the child; kill it where it hangs. Safe to call twice."""
        if not self._closed:
            self._closed = True
            self.pipe.close(_CLOSING)
            self._release()

    def _release(self) -> None:
        for part in (self._reader, self._segment):
            if part is not None:
                part.close()
        if self._child_segment:
            remove_dead(self._child_segment)
        self._reader, self._segment, self._child_segment = None, None, ""


def layouts_of(inputs: Arrays, outputs: Arrays) -> tuple[Layout, Layout]:
    """Return the layouts of a question and of its answer."""
    questions, answers = (
        {"number": StateSpec((), "int64")}
        | {
            f"{prefix}{i}": StateSpec(array.shape, array.dtype.name)
            for i, array in enumerate(arrays.values())
        }
        for prefix, arrays in (("x", inputs), ("y", outputs))
    )
    return Layout(questions | {"fresh": StateSpec((), "int32")}, None), Layout(answers, None)


class Question:
    """One binding of the network; called, it waits for the answer, as other networks do.

    Args:
        network: in the child, or another one with this interface.
        inputs: arrays that are asked about.
        outputs: arrays that take the answer.
    """

    def __init__(self, network: Any, inputs: list[Array], outputs: list[Array]) -> None:
        self._network, self._reader = network, network.reader
        asked, answer = network.questions, network.answers
        self._asked = [(asked[f"x{i}"], array) for i, array in enumerate(inputs)]
        self._answers = [(array, answer[f"y{i}"]) for i, array in enumerate(outputs)]
        self._number, self._fresh = asked["number"], asked["fresh"]
        self._answered = answer["number"]
        self._due, self._anew, self._awaited = 0, True, False

    def __call__(self) -> None:
        self.ask()
        self.take(wait=True)

    def ask(self) -> None:
        """Hand the inputs over; an answer that is still awaited is dropped."""
        for there, here in self._asked:
            there[...] = here
        self._publish()

    def _publish(self) -> None:
        self._network.number += 1
        self._due = self._network.number
        self._number[...], self._fresh[...] = self._due, self._anew
        self._anew, self._awaited = False, True
        self._network.writer.publish()

    def take(self, *, wait: bool) -> bool:
        """Bring the answer into the outputs; False where it is not there yet.

        Args:
            wait: for it.

        Raises:
            Fault: the child has died, reports a fault, or hangs while it is waited for.
        """
        reader = self._reader
        end = time.monotonic() + PATIENCE if wait else 0.0
        while not (reader.take() and self._answered == self._due):
            self._network.look()
            if not wait:
                return False
            if time.monotonic() > end:
                raise Fault(
                    f"{self._network.what}: {self._network.culprit} has not answered for "
                    f"{PATIENCE:g} s: it hangs or was stopped"
                )
            reader.wait(_LOOK)
        for here, there in self._answers:
            here[...] = there
        self._awaited = False
        return True

    def forget(self) -> None:
        """Drop the answer that is awaited; the network begins anew with what is asked next."""
        self._anew, self._awaited = True, False

    def save(self) -> list[Any]:
        """Return what is awaited; what the network remembers inside itself cannot be had."""
        return [self._awaited, *(there.copy() for there, _ in self._asked)]

    def load(self, saved: list[Any]) -> None:
        """Ask once more what was awaited."""
        awaited, *asked = saved
        self.forget()
        if awaited:
            for (there, _), values in zip(self._asked, asked):
                there[...] = values
            self._publish()


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
    assert isinstance(contract.child, ChildSpec)
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
