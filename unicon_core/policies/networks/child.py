"""A network in a process of its own: what it takes goes there and what it gives comes back.

Both go through shared memory (`states/backends/shm/`), and nobody waits for the other but where
`take` is told to. The child keeps nothing but the network: what is fed back comes with each call,
so that an answer to a question that nobody asks any more is dropped without a trace.
"""

from __future__ import annotations

import os
import time
from typing import Any

from unicon_base.arrays import Array
from unicon_base.errors import Fault, PolicyError
from unicon_core.platforms.child.pipe import Pipe
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks.onnx_file import Arrays, Tensor
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

# How often a child that is waited for is looked at, in [s].
_LOOK = 0.005

_MODULE = "unicon_core.policies.networks.child_process"


class ChildNetwork:
    """The network of a contract in a child, as if it were here.

    Args:
        contract: the policy; with `child`, which says how it runs there.

    Attributes:
        inputs, outputs: tensors of the network.
        process: the child.

    Raises:
        UniconError: what was raised there when the network was loaded.
        PolicyError: the child did not start.
    """

    def __init__(self, contract: PolicyContract) -> None:
        self.what = f"policy {contract.name!r}"
        self.number = 0
        self._closed = False
        self._channel: _Channel | None = None
        self.pipe = Pipe(self.what, {"contract": contract}, _MODULE)
        self.process = self.pipe.process
        try:
            told = self.pipe.answer(START, SIGNALS.check)
        except BaseException:
            self.close()
            raise
        self.inputs: tuple[Tensor, ...] = told["inputs"]
        self.outputs: tuple[Tensor, ...] = told["outputs"]
        self.warnings: list[str] = told["warnings"]

    def bind(self, inputs: Arrays, outputs: Arrays) -> Question:
        """Return what asks the child about these arrays, and brings its answers into them.

        Raises:
            UniconError: the network cannot be bound to them.
            PolicyError: it has been bound to arrays of other shapes.
        """
        if self._channel is None:
            self._channel = _Channel(self, inputs, outputs)
        return self._channel.question(inputs, outputs)

    def close(self) -> None:
        """End the child; kill it where it hangs. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self.pipe.close(_CLOSING)
        if self._channel is not None:
            self._channel.close()


def _layouts(inputs: Arrays, outputs: Arrays) -> tuple[Layout, Layout]:
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


class _Channel:
    """Both segments of a network, laid out by the first arrays that it is bound to."""

    def __init__(
        self,
        network: ChildNetwork,
        inputs: Arrays,
        outputs: Arrays,
    ) -> None:
        self.network = network
        self._names = (tuple(inputs), tuple(outputs))
        self._layouts = _layouts(inputs, outputs)
        self.questions, self.answers = map(States, self._layouts)
        name = f"policy-{os.getpid()}-{id(self) & 0xFFFF:x}"
        self._child_segment = f"{name}-child"
        self._segment = Segment.create(name, {QUESTION: self.questions.layout})
        self._reader: ShmReader | None = None
        try:
            self.writer = ShmWriter(self._segment, QUESTION, self.questions)
            layouts = (layout.to_json() for layout in self._layouts)
            network.pipe.tell("bind", name, self._child_segment, *map(list, self._names), *layouts)
            network.pipe.answer(START, SIGNALS.check)
            self._reader = ShmReader(self._child_segment, ANSWER, self.answers)
            self._segment.unlink()  # nobody else is to find them
            self._reader.unlink()
        except BaseException:
            self.close()
            raise

    @property
    def reader(self) -> ShmReader:
        """What takes answers."""
        assert self._reader is not None
        return self._reader

    def question(self, inputs: Arrays, outputs: Arrays) -> Question:
        """Return what asks about some arrays."""
        same = (tuple(inputs), tuple(outputs)) == self._names
        if not same or _layouts(inputs, outputs) != self._layouts:
            raise PolicyError(
                f"{self.network.what}: its network in a child is bound to other sizes already; "
                "leave out child"
            )
        return Question(self, list(inputs.values()), list(outputs.values()))

    def close(self) -> None:
        """Let go of both segments."""
        if self._reader is not None:
            self._reader.close()
        self._segment.close()
        remove_dead(self._child_segment)


class Question:
    """One binding of the network; called, it waits for the answer, as other networks do.

    Args:
        channel: to the child.
        inputs: arrays that are asked about.
        outputs: arrays that take the answer.
    """

    def __init__(self, channel: _Channel, inputs: list[Array], outputs: list[Array]) -> None:
        self._channel, self._network = channel, channel.network
        asked, told = channel.questions, channel.answers
        self._asked = [(asked[f"x{i}"], array) for i, array in enumerate(inputs)]
        self._told = [(array, told[f"y{i}"]) for i, array in enumerate(outputs)]
        self._number, self._fresh = asked["number"], asked["fresh"]
        self._answered = told["number"]
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
        self._channel.writer.publish()

    def take(self, *, wait: bool) -> bool:
        """Bring the answer into the outputs; False where it is not there yet.

        Args:
            wait: for it.

        Raises:
            Fault: the child has died, tells of a fault, or hangs while it is waited for.
        """
        reader = self._channel.reader
        end = time.monotonic() + PATIENCE if wait else 0.0
        while not (reader.take() and self._answered == self._due):
            self._look()
            if not wait:
                return False
            if time.monotonic() > end:
                raise Fault(
                    f"{self._network.what}: its process {self._network.process.pid} has not "
                    f"answered for {PATIENCE:g} s: it hangs or was stopped"
                )
            reader.wait(_LOOK)
        for here, there in self._told:
            here[...] = there
        self._awaited = False
        return True

    def _look(self) -> None:
        if self._network.process.poll() is None:
            return
        told = self._network.pipe.words()
        raise Fault(told.get("fault") or self._network.pipe.end)

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
