"""Calls two services of /unicon again and again. Arguments: SECONDS FILE.

Writes how long each answer took in [ms], the first of each left out, as JSON; null for none in 2 s.
"""

import json
import random
import sys
import time
from pathlib import Path

import rclpy
from rcl_interfaces.srv import GetParameters
from std_srvs.srv import Trigger

rclpy.init()
node = rclpy.create_node("steady_caller")
calls = [
    (node.create_client(Trigger, "/unicon/clear_estop"), Trigger.Request()),
    (node.create_client(GetParameters, "/unicon/get_parameters"), GetParameters.Request()),
]
executor = rclpy.executors.SingleThreadedExecutor()
executor.add_node(node)
took: list[float | None] = []
for client, _ in calls:
    client.wait_for_service(20.0)
end = time.monotonic() + float(sys.argv[1])
while time.monotonic() < end:
    for client, request in calls:
        begun = time.perf_counter()
        answer = client.call_async(request)
        executor.spin_until_future_complete(answer, 2.0)
        took.append(1e3 * (time.perf_counter() - begun) if answer.done() else None)
        time.sleep(random.uniform(0.02, 0.12))
Path(sys.argv[2]).write_text(json.dumps(took[len(calls) :]))
node.destroy_node()
rclpy.try_shutdown()
