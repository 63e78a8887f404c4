"""The network of a policy at a server, over ZeroMQ: the client's end, and what both ends say.

Each message has two parts, a head and a body. The head is Python's struct `<8sqqq32s`: `UNICONP1`;
what the message is; number of the question; time of the network in [ns] by the server's clock;
contract hash of the sender. The body of a question and of its answer are the bytes of `layouts_of`,
little endian; nothing is ever unpickled.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from unicon_base import Fault, PolicyError, UniconError
from unicon_base.arrays import Float64
from unicon_base.resources import sha256_of
from unicon_core.policies.chunks import RemoteSpec
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks.child import (
    Question,
    Sides,
    layouts_of,
    schedule,
    sides_of,
    tensors_of,
)
from unicon_core.policies.networks.onnx_file import Arrays, read_onnx
from unicon_core.policies.networks.torch import lerobot_files
from unicon_core.policies.policy_states import TIMES
from unicon_core.signals import SIGNALS
from unicon_core.states import States
from unicon_core.states.backends.zmq_socket import Endpoint

HEAD = struct.Struct("<8sqqq32s")
MAGIC = b"UNICONP1"

HELLO, READY, QUESTION, ANSWER, REFUSED = range(5)
"""What a message is. READY answers HELLO with the tensors as JSON; REFUSED says why not."""

LARGEST = 1 << 26
"""Bytes of a message: three cameras of 640 × 480 in float32 take 11 MB."""
LONGEST = 1000
"""Bytes that are read of why a server refuses."""
START = 3.0
"""Longest wait for a server in [s]."""
AGAIN = 0.2
"""A question without an answer is sent again after so long, in [s]."""
KEPT = 10_000
"""Answers whose times are kept for the report, the newest."""


def contract_hash(contract: PolicyContract) -> bytes:
    """Return what both ends compare: SHA-256 over the network and what it takes and gives.

    These are the files of the network with their tensors, and the contract's `inputs`, `outputs`,
    `recurrent` and `feeds`; of LeRobot's folder its configuration and normalisation besides. Pose,
    gains and terms are the client's alone.

    Raises:
        PolicyError: a file is missing or broken, or a TorchScript network.
    """
    said: list[Any] = [contract.inputs, contract.outputs, contract.recurrent, contract.feeds]
    said += [(part.name, part.feeds) for part in contract.networks]
    files = lerobot_files(contract.model.parent) if contract.is_lerobot else []
    for model in () if files else (contract.model, *(part.model for part in contract.networks)):
        if contract.is_torchscript:
            raise PolicyError(
                f"{model}: a server runs networks that say their sizes, ONNX and LeRobot's "
                "folders; export it as ONNX"
            )
        files += [model, *(model.parent / name for name in read_onnx(model).external)]
    said += map(sha256_of, files)
    return hashlib.sha256(json.dumps(said, default=str, sort_keys=True).encode()).digest()


@contextmanager
def patient_threads() -> Iterator[None]:
    """Let this thread, and those that are started meanwhile, preempt no tick when they wake.

    That is SCHED_BATCH in place of SCHED_OTHER: on one core a policy's p99 fell from 16 to 0.3 ms.
    """
    usual = os.sched_getscheduler(0)
    if usual == os.SCHED_OTHER:
        schedule(os.SCHED_BATCH)
    try:
        yield
    finally:
        if usual == os.SCHED_OTHER:
            schedule(usual)


def packed(
    digest: bytes, kind: int, body: Any = b"", number: int = 0, inference_ns: int = 0
) -> list[Any]:
    """Return a message."""
    return [HEAD.pack(MAGIC, kind, number, inference_ns, digest), body]


def unpacked(message: list[bytes]) -> tuple[int, int, int, bytes, bytes]:
    """Return kind, number, time of the network in [ns], hash and body; kind −1 of garbage."""
    if len(message) != 2 or len(message[0]) != HEAD.size or not message[0].startswith(MAGIC):
        return -1, 0, 0, b"", b""
    _, kind, number, inference_ns, digest = HEAD.unpack(message[0])
    return kind, number, inference_ns, digest, message[1]


def fill(states: States, body: bytes) -> bool:
    """Take states from a body; False where it has another length."""
    fits = len(body) == states.buffer.size
    if fits:
        states.buffer.data[:] = body
    return fits


class RemoteNetwork:
    """The network of a contract at a server, with the interface of a `ChildNetwork`.

    ZeroMQ's own thread does the work of the socket: what a tick sends or takes goes through its
    queues, without waiting. The newest question alone counts, and answers to others are dropped.
    What is fed back comes with each question, so that a server that was restarted goes on.

    Args:
        contract: the policy, whose network is here as well, but is not loaded; with `remote`.

    Raises:
        MissingDependencyError: pyzmq is not installed.
        PolicyError: no server answers, or one with another contract hash.
        StateError: a key is missing.
    """

    warnings = ()

    def __init__(self, contract: PolicyContract) -> None:
        spec = contract.child
        assert isinstance(spec, RemoteSpec)
        self.what = f"policy {contract.name!r}"
        self.culprit = f"the server at {spec.address}"
        self.measured = {name: np.zeros((), np.float32) for name in TIMES}
        self.reader = self.writer = self
        self.number = self._number = 0  # of the newest question, and of the newest answer
        self._digest = contract_hash(contract)
        self._times: deque[tuple[float, float]] = deque(maxlen=KEPT)
        self._refused, self._sides, self._new, self._sent_ns = "", Sides(), False, 0
        with patient_threads():
            self._end = Endpoint(
                self.what, spec.address, publish=None, bind=False, size=LARGEST, keys=spec.keys
            )
        end = time.monotonic() + START
        try:
            while not self._sides:
                SIGNALS.check()
                self._end.rejoin()
                self._send(HELLO)
                if self.wait(0.1):
                    self._drain()
                if self._refused:
                    raise PolicyError(self._refused)
                if time.monotonic() > end:
                    raise PolicyError(
                        f"{self.what}: {self.culprit} has not answered for {START:g} s; start it: "
                        "unicon serve, or correct remote.address and remote.keys"
                    )
        except BaseException:
            self.close()
            raise
        self.inputs, self.outputs = self._sides
        self.questions, self.answers = map(States, layouts_of(self._sides))

    def bind(self, inputs: Arrays, outputs: Arrays) -> Question:
        """Return what asks the server about these arrays, and brings its answers into them.

        Raises:
            PolicyError: the network has other sizes.
        """
        asked, answered = (
            {each.name: np.zeros(each.fixed, each.dtype) for each in side} | {**arrays}
            for side, arrays in zip(self._sides, (inputs, outputs))
        )
        if sides_of(asked, answered) != self._sides:
            raise PolicyError(f"{self.what}: its network has free sizes; export it with fixed ones")
        return Question(self, asked.values(), answered.values())

    def publish(self) -> None:
        """Send the question."""
        self._sent_ns = time.monotonic_ns()
        self._send(QUESTION, self.questions.buffer.data, self.number)

    def _send(self, *given: Any) -> None:  # what is lost is sent again
        self._end.send(packed(self._digest, *given))

    def look(self) -> None:
        """Ask again where the answer takes long.

        Raises:
            Fault: the server refuses to answer.
        """
        if self._refused:
            raise Fault(self._refused)
        if time.monotonic_ns() - self._sent_ns > AGAIN * 1e9:
            self._end.rejoin()
            self.publish()

    def receive(self) -> None:
        """Look at what has come, where an answer is awaited."""
        if self._number != self.number:
            self._drain()

    def _drain(self) -> None:
        for message in self._end.received():
            self._hear(message)
            if self._new:  # to find nothing more costs 45 µs
                return

    def _hear(self, message: list[bytes]) -> None:
        kind, number, inference_ns, digest, body = unpacked(message)
        if kind < 0:
            return
        if digest != self._digest:
            self._refused = (
                f"{self.what}: {self.culprit} has contract hash {digest.hex()[:12]}… and this "
                f"policy {self._digest.hex()[:12]}…: give both the same network"
            )
        elif kind == READY:
            try:
                self._sides = tensors_of(json.loads(body))
                fits = max(each.nbytes for each in layouts_of(self._sides)) < LARGEST
            except (ValueError, TypeError, RecursionError, UniconError):
                fits = False
            if not fits:
                self._refused = (
                    f"{self.what}: {self.culprit} does not say what its network takes and gives; "
                    "run unicon serve of this version there"
                )
        elif kind == REFUSED:
            text = " ".join(body[:LONGEST].decode(errors="replace").split())
            self._refused = f"{self.what}: {self.culprit}: {text}"
        elif kind == ANSWER and number == self.number != self._number and fill(self.answers, body):
            self._number, self._new = number, True
            times = (time.monotonic_ns() - self._sent_ns) * 1e-9, inference_ns * 1e-9
            self._times.append(times)
            for state, value in zip(self.measured.values(), times):
                state[...] = value

    def take(self) -> bool:
        """Return whether an answer has come since the last call; it is in `answers`."""
        self.receive()
        new, self._new = self._new, False
        return new

    def wait(self, timeout: float) -> bool:
        """Return True when a message has come, False after `timeout` [s]."""
        return bool(self._end.socket.poll(round(timeout * 1e3)))

    def latency(self) -> dict[str, Float64]:
        """Return round trips and times of the network, of the newest answers in [ms]; or {}."""
        return dict(zip(("round_trip_ms", "inference_ms"), np.array(self._times).T * 1e3))

    def close(self) -> None:
        """Leave the server. Safe to call twice."""
        self._end.close()
