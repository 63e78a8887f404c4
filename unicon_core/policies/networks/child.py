"""The network of a policy in a process of its own: the parent's end, and the child.

The child reads the contract from stdin, then one line that says to what it is bound; stdin's end
asks it to end. It ends, too, when its parent has died, and when a call hangs.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import astuple
from typing import Any, TypeAlias

import numpy as np

from unicon_base.arrays import Array, Float64
from unicon_base.errors import Fault, PolicyError, UniconError
from unicon_core.platforms.child.pipe import ALARM, LONGEST, Parent, Pipe, text_of
from unicon_core.policies.chunks import ChildSpec
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks import Network, Remembering, Tensor, open_network
from unicon_core.policies.networks.onnx_file import Arrays
from unicon_core.signals import SIGNALS
from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter, remove_dead

Sides: TypeAlias = tuple[tuple[Tensor, ...], ...]
"""What a network takes and what it gives; () while it is bound to nothing."""

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

OFTEN, NAP = 0.01, 0.001
"""The child sleeps until it is woken where questions come within `OFTEN` [s]. Else it looks every
`NAP` [s]: to wake a process on an idle core takes a tick 60 µs."""

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
        culprit: what has to answer, for messages.
        measured: states of the policy that the network gives beside its outputs.

    Raises:
        UniconError: what was raised there when the network was loaded.
        PolicyError: the child did not start.
    """

    measured: Mapping[str, Array] = {}

    def __init__(self, contract: PolicyContract) -> None:
        self.what = f"policy {contract.name!r}"
        self.number = 0
        self._closed = False
        self._sides: Sides = ()
        self._ends: list[Segment | ShmReader] = []
        self._child_segment = ""
        self.pipe = Pipe(self.what, {"contract": contract}, _MODULE)
        self.process = self.pipe.process
        self.culprit = f"its process {self.process.pid}"
        try:
            reply = self.pipe.answer(START, SIGNALS.check)
        except BaseException:
            self.close()
            raise
        self.inputs, self.outputs = reply["sides"]
        self.warnings: list[str] = reply["warnings"]

    def bind(self, inputs: Arrays, outputs: Arrays) -> Question:
        """Return what asks the child about these arrays, and brings its answers into them.

        Raises:
            UniconError: the network cannot be bound to them.
            PolicyError: it has been bound to arrays of other shapes.
        """
        sides = sides_of(inputs, outputs)
        if not self._sides:
            try:
                self._open(sides)
            except BaseException:
                self._release()
                raise
        if sides != self._sides:
            raise PolicyError(
                f"{self.what}: its network in a child is bound to other sizes already; "
                "leave out child"
            )
        return Question(self, inputs.values(), outputs.values())

    def _open(self, sides: Sides) -> None:
        self.questions, self.answers = map(States, layouts_of(sides))
        name = f"policy-{os.getpid()}-{id(self) & 0xFFFF:x}"
        self._child_segment = f"{name}-child"
        segment = Segment.create(name, {QUESTION: self.questions.layout})
        self._ends.append(segment)
        self.writer = ShmWriter(segment, QUESTION, self.questions)
        self.pipe.tell("bind", name, self._child_segment, plain(sides))
        self.pipe.answer(START, SIGNALS.check)
        self.reader = ShmReader(self._child_segment, ANSWER, self.answers)
        self._ends.append(self.reader)
        for end in self._ends:  # nobody else is to find them
            end.unlink()
        self._sides = sides

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

    def close(self) -> None:
        """End the child; kill it where it hangs. Safe to call twice."""
        if not self._closed:
            self._closed = True
            self.pipe.close(_CLOSING)
            self._release()

    def _release(self) -> None:
        while self._ends:
            self._ends.pop().close()
        if self._child_segment:
            remove_dead(self._child_segment)


def sides_of(*sides: Arrays) -> Sides:
    """Return what a network is bound to, as tensors."""
    return tuple(
        tuple(Tensor(name, array.dtype.name, array.shape) for name, array in side.items())
        for side in sides
    )


def plain(sides: Sides) -> Any:
    """Return the tensors of both sides for JSON; `tensors_of` takes them back."""
    return [[astuple(tensor) for tensor in side] for side in sides]


def tensors_of(said: Any) -> Sides:
    """Return the tensors of both sides that JSON says.

    Raises:
        TypeError, ValueError: it says something else.
    """
    inputs, outputs = ([Tensor(name, dtype, tuple(s)) for name, dtype, s in side] for side in said)
    return tuple(inputs), tuple(outputs)


def layouts_of(sides: Sides) -> list[Layout]:
    """Return the layouts of a question and of its answer, for tensors of fixed sizes."""
    asked, told = (
        {"number": StateSpec((), "int64")}
        | {f"x{i}": StateSpec(each.fixed, each.dtype) for i, each in enumerate(side)}
        for side in sides
    )
    return [Layout(asked | {"fresh": StateSpec((), "int32")}, None), Layout(told, None)]


class Bound:
    """A network that is bound to a question and to its answer, for one robot.

    Args:
        network: it.
        sides: its tensors, of fixed sizes.

    Attributes:
        asked, told: question and answer.
        call: runs the network on them.
    """

    def __init__(self, network: Network, sides: Sides) -> None:
        self.asked, self.told = both = [*map(States, layouts_of(sides))]
        self.call = network.bind(
            *(
                {tensor.name: states[f"x{i}"] for i, tensor in enumerate(side)}
                for side, states in zip(sides, both)
            )
        )
        self._keeps = self.call if isinstance(self.call, Remembering) else None
        self._fresh = self.asked["fresh"]
        self._number, self._answered = self.asked["number"], self.told["number"]

    def answer(self) -> None:
        """Answer the question."""
        if self._keeps and self._fresh:
            self._keeps.reset()
        self.call()
        if self._keeps:
            self._keeps.commit()
        self._answered[...] = self._number


class Question:
    """One binding of the network; called, it waits for the answer, as other networks do.

    Args:
        network: in the child, or another one with this interface.
        inputs: arrays that are asked about.
        outputs: arrays that take the answer.
    """

    def __init__(self, network: Any, inputs: Iterable[Array], outputs: Iterable[Array]) -> None:
        self._network, self._reader = network, network.reader
        asked, answer = network.questions, network.answers
        self._asked = [(asked[f"x{i}"], array) for i, array in enumerate(inputs)]
        self._answers = [(array, answer[f"x{i}"]) for i, array in enumerate(outputs)]
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
    what = f"policy {contract.name!r}"
    try:
        warnings = [f"{what}: {refused}" for refused in _prepare(contract)]
        network = open_network(contract)
        parent.tell(sides=(network.inputs, network.outputs), warnings=warnings)
        wishes: Any = []
        while not wishes:
            if wishes is None:
                return 0
            signal.alarm(round(START) + ALARM)
            time.sleep(0.001)
            wishes = parent.wishes()
        _, theirs, own, sides = wishes[0]
        bound = Bound(network, tensors_of(sides))
        bound.call()  # the first call takes longest
        reader = ShmReader(theirs, QUESTION, bound.asked)
        reader.unlink()  # nothing is left of a parent that is killed from here on
        segment = Segment.create(own, {ANSWER: bound.told.layout})
        writer = ShmWriter(segment, ANSWER, bound.told)
        parent.tell(bound=True)
    except UniconError as error:
        parent.tell(error=str(error)[:LONGEST], kind=type(error).__name__)
        return 1
    except Exception as error:
        parent.tell(error=f"{what}: its process raised {text_of(error)}", kind="PolicyError")
        return 1
    looked, asked, often = 0.0, 0.0, True
    try:
        with np.errstate(all="ignore"):
            while True:
                signal.alarm(ALARM)  # the kernel ends a call that hangs, also without a parent
                reader.wait(_LOOK) if often else time.sleep(NAP)
                now = time.monotonic()
                if reader.take():
                    often, asked = now - asked < OFTEN, now
                    bound.answer()
                    writer.publish()
                if now - looked > _LOOK:
                    looked = now
                    if parent.wishes() is None or not reader.alive():
                        return 0  # the parent has closed or died
    except Exception as error:
        parent.tell(fault=f"{what}: its process raised {text_of(error)}")
        return 3


def schedule(policy: int) -> None:
    """Let this thread be scheduled by a policy without priorities, such as SCHED_BATCH."""
    with suppress(OSError):
        os.sched_setscheduler(0, policy, os.sched_param(0))


def _prepare(contract: PolicyContract) -> Iterator[str]:
    """Go to the core that is wished; yield what was refused."""
    assert isinstance(contract.child, ChildSpec)
    schedule(os.SCHED_BATCH)  # being woken, it takes no core from the tick that woke it
    if (cpu := contract.child.cpu) is not None:
        try:
            os.sched_setaffinity(0, {cpu})
        except (OSError, AttributeError) as error:
            last = (os.cpu_count() or 1) - 1
            yield f"core {cpu} refused ({error}); known: 0 to {last} (child.cpu)"


if __name__ == "__main__":
    # No destructors: runtimes' libraries print tracebacks when Python tears them down.
    status = main()
    sys.stderr.flush()
    os._exit(status)
