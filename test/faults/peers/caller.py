"""Calls services of the node. Arguments: LOG RUNS_LOG AT WORD …

The first word follows when the run has begun tick AT, each of the others 0.5 s after the one before
it. A word is a service of type Trigger; or `flood`: for 2 s all services but ~/stop and ~/estop are
called, without waiting for their answers; `flood estop`: in the middle of it ~/estop is pressed; or
NAME=VALUE,…: parameters are set. The fault is the first call of ~/estop, else the beginning of the
flood, or what is set.
"""

from __future__ import annotations

import sys
import time
from itertools import cycle
from pathlib import Path
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from std_srvs.srv import Trigger

from faults.command_log import FAULT, RECV, CommandLog

PATIENCE = 30.0  # s until the service is there and an answer has come
SHORT = 6.0  # s for an answer: a node that hangs gives none
FLOOD_S = 2.0
TOGETHER = 4  # calls that leave at once, every 5 ms
HARMLESS = ("start", "clear_estop", "reset", "pause", "step")  # while a robot moves


class Caller:
    """Clients of all services of the node.

    Args:
        log: where the fault is marked.
    """

    def __init__(self, log: CommandLog) -> None:
        self._log = log
        self.node = rclpy.create_node("caller")
        self._clients: dict[str, Any] = {}
        self._marked = False

    def client(self, kind: Any, name: str) -> Any:
        """Return the client of a service of the node."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, f"/unicon/{name}")
        return self._clients[name]

    def mark(self) -> None:
        """Note that the fault comes now, once."""
        if not self._marked:
            self._marked = True
            self._log.add(FAULT)

    def obey(self, word: str) -> None:
        """Do what a word says, and tell what came of it."""
        if word.startswith("flood"):
            self._flood(press=word.endswith("estop"))
        elif "=" in word:
            self._set(word)
        elif not self.client(Trigger, word).wait_for_service(timeout_sec=1.0):
            print(f"{word}: no such service", flush=True)
        else:
            if word == "estop":
                self.mark()
            print(f"{word}: {self._answer(self.client(Trigger, word), Trigger.Request())}")

    def _answer(self, client: Any, request: Any) -> Any:
        answer = client.call_async(request)
        rclpy.spin_until_future_complete(self.node, answer, timeout_sec=SHORT)
        return answer.result()

    def _set(self, word: str) -> None:
        parameters = []
        for pair in word.split(","):
            name, _, value = pair.partition("=")
            number = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float(value))
            parameters.append(Parameter(name=name, value=number))
        client = self.client(SetParameters, "set_parameters")
        client.wait_for_service(timeout_sec=PATIENCE)
        self.mark()
        print(f"{word}: {self._answer(client, SetParameters.Request(parameters=parameters))}")

    def _flood(self, press: bool) -> None:
        calls = [(self.client(Trigger, word), Trigger.Request()) for word in HARMLESS]
        names = ["stiffness_scale", "workflow", "no such parameter"]
        others: list[tuple[Any, str, dict[str, Any]]] = [
            (GetParameters, "get_parameters", {"names": names}),
            (ListParameters, "list_parameters", {}),
            (GetState, "get_state", {}),
            (ChangeState, "change_state", {}),  # a transition that does not exist
        ]
        for kind, name, fields in others:
            calls.append((self.client(kind, name), kind.Request(**fields)))
        for client, _ in calls:
            client.wait_for_service(timeout_sec=PATIENCE)
        estop = self.client(Trigger, "estop")
        estop.wait_for_service(timeout_sec=PATIENCE)
        asked: list[Any] = []
        began = time.monotonic()
        if not press:
            self.mark()
        for client, request in cycle(calls):
            asked.append(client.call_async(request))
            if len(asked) % TOGETHER:
                continue
            elapsed = time.monotonic() - began
            if elapsed > FLOOD_S:
                break
            if press and elapsed > FLOOD_S / 2:
                press = False
                self.mark()
                estop.call_async(Trigger.Request())
            rclpy.spin_once(self.node, timeout_sec=0.005)
        answered = sum(each.done() for each in asked)
        print(f"{len(asked)} calls, {answered} answers", flush=True)


def main() -> None:
    """Run until all was called."""
    log, runs = CommandLog(Path(sys.argv[1])), CommandLog(Path(sys.argv[2]))
    at, words = int(sys.argv[3]), sys.argv[4:]
    rclpy.init()
    caller = Caller(log)
    if not caller.client(Trigger, "start").wait_for_service(timeout_sec=PATIENCE):
        sys.exit("no service ~/start")
    end = time.monotonic() + PATIENCE
    while runs.of(RECV).size <= at and time.monotonic() < end:
        time.sleep(0.001)
    for word in words:
        caller.obey(word)
        time.sleep(0.5)
    time.sleep(0.5)


main()
