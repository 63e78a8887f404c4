"""The server of a policy's network, for `unicon serve`: one process for several robots."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import one_line
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks import Network, open_network
from unicon_core.policies.networks.child import layouts_of
from unicon_core.policies.networks.onnx_file import Tensor
from unicon_core.policies.networks.remote import (
    ANSWER,
    HELLO,
    KEPT,
    LARGEST,
    LOOKS,
    QUESTION,
    READY,
    REFUSED,
    blank,
    contract_hash,
    fill,
    packed,
    patient_threads,
    unpacked,
)
from unicon_core.states import States
from unicon_core.states.backends.zmq_socket import Endpoint

MOST = 16
"""Robots whose arrays are kept, those that asked last; another one gets new ones."""
LOOK = 0.1
"""How often the server looks whether it shall end, in [s]."""


class PolicyServer:
    """Runs a network for robots that ask.

    Each has arrays of its own. Nobody is waited for: an answer that a robot does not take is
    dropped, and of its questions the newest is answered.

    Args:
        contract: the policy; axes of its tensors that are free have length 1.
        address: where it listens, such as `tcp://*:5560`.
        keys: folder with CURVE keys; None: without, on this machine alone.

    Attributes:
        address: with the port.
        key: public key, "" without keys.
        digest: contract hash.
        times: of the network's newest calls, in [s].
        answered, garbage: messages.

    Raises:
        PolicyError, MissingDependencyError: of the network.
        StateError: the address cannot be had, or a key is missing.
    """

    def __init__(self, contract: PolicyContract, address: str, keys: Path | None = None) -> None:
        self.digest = contract_hash(contract)
        network = open_network(contract)
        given = {*contract.outputs.values(), *(pair.output for pair in contract.recurrent)}
        outputs = [tensor for tensor in network.outputs if tensor.name in given]
        self._made = network, [*map(_fixed, network.inputs)], [*map(_fixed, outputs)]
        _Robot(*self._made).call()  # the first call takes longest
        self.times: deque[float] = deque(maxlen=KEPT)
        self.answered = self.garbage = 0
        self._robots: dict[bytes, _Robot] = {}
        self._ended = False
        what = f"policy {contract.name!r}"
        self._end = Endpoint(what, address, publish=None, bind=True, size=LARGEST, keys=keys)
        self.address, self.key, self._zmq = self._end.address, self._end.key, self._end.zmq

    def stop(self) -> None:
        """Let `run` end; for a signal."""
        self._ended = True

    def run(self, look: Callable[[], object] = bool) -> None:
        """Serve until `stop`.

        Args:
            look: called now and then.
        """
        with patient_threads(), np.errstate(all="ignore"):  # a robot may run on this machine
            while not self._ended:
                if self._end.socket.poll(round(LOOK * 1e3)):
                    self._serve()
                look()

    def _serve(self) -> None:
        """Take what has come, and answer the newest question of each robot."""
        for _ in range(LOOKS):
            try:
                name, *message = self._end.socket.recv_multipart(self._zmq.NOBLOCK)
            except self._zmq.Again:
                break
            self._hear(name, message)
        for name, robot in [*self._robots.items()]:
            if robot.due:
                self._answer(name, robot)

    def close(self) -> None:
        """Let go. Safe to call twice."""
        self._end.close()

    def _send(self, name: bytes, *given: Any) -> None:
        """Send a message; ROUTER drops what a robot has no room for, or is not there for."""
        with suppress(self._zmq.ZMQError):
            parts = [name, *packed(self.digest, *given)]
            self._end.socket.send_multipart(parts, self._zmq.NOBLOCK)

    def _hear(self, name: bytes, message: list[bytes]) -> None:
        kind, number, _, digest, body = unpacked(message)
        if kind not in (HELLO, QUESTION):
            self.garbage += 1
        elif digest != self.digest:
            self._send(name, REFUSED)  # its head says why
        elif kind == HELLO:
            tensors = [[astuple(tensor) for tensor in side] for side in self._made[1:]]
            self._send(name, READY, json.dumps(tensors).encode())
        else:
            robots = self._robots
            robot = robots[name] = robots.pop(name) if name in robots else _Robot(*self._made)
            if len(robots) > MOST:
                del robots[next(iter(robots))]
            if number == robot.number and not robot.due:  # the answer was lost on its way
                self._tell(name, robot)
            elif number > robot.number and fill(robot.asked, body):
                robot.number, robot.due = number, True

    def _answer(self, name: bytes, robot: _Robot) -> None:
        begun = time.perf_counter_ns()
        try:
            robot.call()
        except Exception as error:  # whatever a runtime raises
            del self._robots[name]  # its arrays hold no answer
            self._send(name, REFUSED, f"its network raised {one_line(error)}".encode())
            return
        robot.due, robot.inference_ns = False, time.perf_counter_ns() - begun
        robot.told["number"][...] = robot.number
        self.times.append(robot.inference_ns * 1e-9)
        self.answered += 1
        self._tell(name, robot)

    def _tell(self, name: bytes, robot: _Robot) -> None:
        self._send(name, ANSWER, robot.told.buffer.data, robot.number, robot.inference_ns)


class _Robot:
    """The network as bound for one robot.

    Args:
        network: it.
        inputs, outputs: its tensors.

    Attributes:
        asked, told: the newest question and its answer.
        number: of that question.
        due: it waits for its answer.
    """

    number = inference_ns = 0
    due = False

    def __init__(self, network: Network, inputs: list[Tensor], outputs: list[Tensor]) -> None:
        self.asked, self.told = map(States, layouts_of(blank(inputs), blank(outputs)))
        self.call = network.bind(
            {tensor.name: self.asked[f"x{i}"] for i, tensor in enumerate(inputs)},
            {tensor.name: self.told[f"y{i}"] for i, tensor in enumerate(outputs)},
        )


def _fixed(tensor: Tensor) -> Tensor:
    """Return a tensor for one robot."""
    shape = tuple(axis if isinstance(axis, int) else 1 for axis in tensor.shape)
    return replace(tensor, shape=shape or (1,))
