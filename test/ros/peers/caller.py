"""A plain rclpy process: calls services and sets parameters of a node, one after the other.

Nothing of unicon is imported. Usage: caller.py NODE WORD...   where WORD is a Trigger service
(estop), a lifecycle transition (+configure), a parameter (max_vx=0.5, its value as JSON or else a
text), `wait=SECONDS`, `until=STATE` of the lifecycle, or
`flood=SERVICE,SECONDS`. Prints one JSON line for each.
"""

import json
import sys
import time

import rclpy
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import ListParameters, SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("caller")
    target = sys.argv[1]

    clients = {}

    def ask(name: str, request: object, patience: float) -> object:
        future = clients[name].call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=patience)
        return future.result()

    def call(kind: type, name: str, request: object) -> object:
        """Return the answer.

        rmw_fastrtps drops a response if the server has not discovered the client's reader yet.
        Readers are discovered in the order of their making, so a harmless service whose client is
        made last shows by its answer that the client before it is known.
        """
        if name not in clients:
            clients[name] = node.create_client(kind, f"{target}/{name}")
            if not clients[name].wait_for_service(timeout_sec=10.0):
                raise SystemExit(f"no service {target}/{name}")
            last = clients["last"] = node.create_client(ListParameters, f"{target}/list_parameters")
            last.wait_for_service(timeout_sec=10.0)
            if not any(ask("last", ListParameters.Request(), 2.0) for _ in range(5)):
                raise SystemExit(f"{target}/list_parameters did not answer")
        answer = ask(name, request, 10.0)
        if answer is None:
            raise SystemExit(f"{target}/{name} did not answer")
        return answer

    def flood(name: str, seconds: float) -> None:
        client = node.create_client(Trigger, f"{target}/{name}")
        client.wait_for_service(timeout_sec=10.0)
        end, sent = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            client.call_async(Trigger.Request())
            sent += 1
            time.sleep(0.0005)
        print(json.dumps({"word": "flood", "sent": sent}), flush=True)

    def parameter(name: str, value: str) -> object:
        try:
            parsed = json.loads(value)
        except ValueError:
            parsed = value
        # As `ros2 param set` does: a list of nothing is one of truth values.
        kind = Parameter.Type.BOOL_ARRAY if parsed == [] else None
        return Parameter(name, kind, parsed).to_parameter_msg()

    def state() -> str:
        return call(GetState, "get_state", GetState.Request()).current_state.label

    for word in sys.argv[2:]:
        if word.startswith("until="):
            end = time.monotonic() + 30.0
            while state() != word.partition("=")[2]:
                if time.monotonic() > end:
                    raise SystemExit(f"{target}: not {word} within 30 s")
                time.sleep(0.02)
            continue
        if word.startswith("wait="):
            time.sleep(float(word.partition("=")[2]))
            continue
        if word.startswith("flood="):
            name, seconds = word.partition("=")[2].split(",")
            flood(name, float(seconds))
            continue
        begin = time.monotonic()
        if word.startswith("+"):
            request = ChangeState.Request()
            request.transition.label = word[1:]
            answer = {"success": call(ChangeState, "change_state", request).success}
            if word != "+shutdown":  # which ends the process that would answer
                answer["state"] = state()
        elif word == "?":
            answer = {"state": state()}
        elif "=" in word:
            name, _, value = word.partition("=")
            request = SetParameters.Request()
            request.parameters = [parameter(name, value)]
            result = call(SetParameters, "set_parameters", request).results[0]
            answer = {"success": result.successful, "message": result.reason}
        else:
            done = call(Trigger, word, Trigger.Request())
            answer = {"success": done.success, "message": done.message}
        answer |= {"word": word, "seconds": time.monotonic() - begin}
        print(json.dumps(answer), flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


main()
