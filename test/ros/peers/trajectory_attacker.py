"""Talks to the action's services without a client's care; prints what came back.

Nothing of unicon is imported. Does, one after the other: a cancel of nothing, a result of nothing,
the same goal twice, goals that are refused as fast as they are answered, a goal that is cut off.
"""

import json
import time

import rclpy
from action_msgs.srv import CancelGoal
from control_msgs.action import FollowJointTrajectory

BASE = "joint_trajectory_controller/follow_joint_trajectory/_action"


def main():
    rclpy.init()
    node = rclpy.create_node("attacker")
    kinds = FollowJointTrajectory.Impl
    send = node.create_client(kinds.SendGoalService, f"{BASE}/send_goal")
    result = node.create_client(kinds.GetResultService, f"{BASE}/get_result")
    cancel = node.create_client(CancelGoal, f"{BASE}/cancel_goal")
    for client in (send, result, cancel):
        assert client.wait_for_service(timeout_sec=30.0)

    def call(client, request):
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=20.0)
        return future.result()

    def say(what, **values):
        print(json.dumps({"kind": what, **values}), flush=True)

    request = CancelGoal.Request()
    say("cancel all of nothing", code=call(cancel, request).return_code)
    request.goal_info.goal_id.uuid = [7] * 16
    say("cancel the unknown", code=call(cancel, request).return_code)
    asked = kinds.GetResultService.Request()
    asked.goal_id.uuid = [7] * 16
    say("result of the unknown", status=call(result, asked).status)
    goal = kinds.SendGoalService.Request()
    goal.goal_id.uuid = [1] * 16
    say("once", accepted=call(send, goal).accepted)
    say("twice", accepted=call(send, goal).accepted)
    asked.goal_id.uuid = [1] * 16
    answer = call(result, asked)
    say("its result", status=answer.status, code=answer.result.error_code)
    request.goal_info.goal_id.uuid = [1] * 16
    say("cancel what has ended", code=call(cancel, request).return_code)
    began, accepted = time.monotonic(), 0
    for number in range(200):
        goal.goal_id.uuid = list(number.to_bytes(2, "big")) + [9] * 14
        accepted += call(send, goal).accepted
    say("flood", accepted=accepted, seconds=time.monotonic() - began)
    asked.goal_id.uuid = list((199).to_bytes(2, "big")) + [9] * 14
    say("the last of the flood", status=call(result, asked).status)
    asked.goal_id.uuid = list((0).to_bytes(2, "big")) + [9] * 14
    say("the first of the flood", status=call(result, asked).status)
    say("done")


main()
