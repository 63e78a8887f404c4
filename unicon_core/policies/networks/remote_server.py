"""The server of a policy's network, for `unicon serve`: one process for several robots."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import one_line
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks import open_network
from unicon_core.policies.networks.child import Bound, plain
from unicon_core.policies.networks.remote import (
    ANSWER,
    HELLO,
    KEPT,
    LARGEST,
    QUESTION,
    READY,
    REFUSED,
    contract_hash,
    fill,
    packed,
    patient_threads,
    unpacked,
)
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
        sides = tuple(
            tuple(replace(tensor, shape=tensor.fixed) for tensor in side)
            for side in (network.inputs, outputs)
        )
        self._ready = json.dumps(plain(sides)).encode()
        self._robot = partial(_Robot, network, sides)
        self._robot().call()  # the first call takes longest
        self.times: deque[float] = deque(maxlen=KEPT)
        self.answered = self.garbage = 0
        self._robots: dict[bytes, _Robot] = {}
        self._ended = False
        what = f"policy {contract.name!r}"
        self._end = Endpoint(what, address, publish=None, bind=True, size=LARGEST, keys=keys)
        self.address, self.key = self._end.address, self._end.key

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
                    for name, *message in self._end.received():
                        self._hear(name, message)
                    for name, robot in [*self._robots.items()]:
                        if robot.due:  # the newest question of each is answered
                            self._answer(name, robot)
                look()

    def close(self) -> None:
        """Let go. Safe to call twice."""
        self._end.close()

    def _send(self, name: bytes, *given: Any) -> None:
        self._end.send([name, *packed(self.digest, *given)])

    def _hear(self, name: bytes, message: list[bytes]) -> None:
        kind, number, _, digest, body = unpacked(message)
        if kind not in (HELLO, QUESTION):
            self.garbage += 1
        elif digest != self.digest:
            self._send(name, REFUSED)  # its head says why
        elif kind == HELLO:
            self._send(name, READY, self._ready)
        else:
            robots = self._robots
            robot = robots[name] = robots.pop(name) if name in robots else self._robot()
            if len(robots) > MOST:
                del robots[next(iter(robots))]
            if number == robot.number and not robot.due:  # the answer was lost on its way
                self._tell(name, robot)
            elif number > robot.number and fill(robot.asked, body):
                robot.number, robot.due = number, True

    def _answer(self, name: bytes, robot: _Robot) -> None:
        begun = time.perf_counter_ns()
        try:
            robot.answer()
        except Exception as error:  # whatever a runtime raises
            del self._robots[name]  # its arrays hold no answer
            self._send(name, REFUSED, f"its network raised {one_line(error)}".encode())
            return
        robot.due, robot.inference_ns = False, time.perf_counter_ns() - begun
        self.times.append(robot.inference_ns * 1e-9)
        self.answered += 1
        self._tell(name, robot)

    def _tell(self, name: bytes, robot: _Robot) -> None:
        self._send(name, ANSWER, robot.told.buffer.data, robot.number, robot.inference_ns)


class _Robot(Bound):
    """The network as bound for one robot, with its newest question and the answer to that.

    Attributes:
        number: of that question.
        inference_ns: time of the network in [ns].
        due: it waits for its answer.
    """

    number = inference_ns = 0
    due = False
