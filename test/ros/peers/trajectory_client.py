"""A plain rclpy action client of FollowJointTrajectory, as MoveIt's controller manager has one.

Nothing of unicon is imported. Reads JSON lines: `{"goal": NAME, "joints": […], "points": [[time,
[positions], [velocities]], …], "stamp": ns, "path": {joint: tolerance}, "goal_tolerance": …,
"goal_time": s}` and `{"cancel": NAME}`; prints what it hears.
"""

import json
import sys
import threading
import time

import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectoryPoint


def say(kind, **values):
    print(json.dumps({"kind": kind, "at": time.monotonic_ns(), **values}), flush=True)


def duration(seconds):
    return Duration(sec=int(seconds // 1), nanosec=round(seconds % 1 * 1e9))


def goal_of(line):
    goal = FollowJointTrajectory.Goal()
    stamp = line.get("stamp", 0)
    goal.trajectory.header.stamp.sec = stamp // 1_000_000_000
    goal.trajectory.header.stamp.nanosec = stamp % 1_000_000_000
    goal.trajectory.joint_names = line["joints"]
    for seconds, positions, *more in line["points"]:
        point = JointTrajectoryPoint(positions=positions, time_from_start=duration(seconds))
        point.velocities = more[0] if more else []
        goal.trajectory.points.append(point)
    for name, field in (("path", goal.path_tolerance), ("goal_tolerance", goal.goal_tolerance)):
        field.extend(JointTolerance(name=j, position=t) for j, t in line.get(name, {}).items())
    goal.goal_time_tolerance = duration(line.get("goal_time", 0.0))
    return goal


class Client:
    def __init__(self):
        rclpy.init()
        self.node = rclpy.create_node("trajectory_client")
        name = "joint_trajectory_controller/follow_joint_trajectory"
        self.client = ActionClient(self.node, FollowJointTrajectory, name)
        self.handles = {}

    def do(self, line):
        if "cancel" in line:
            say("cancel sent", goal=line["cancel"])
            future = self.handles[line["cancel"]].cancel_goal_async()
            future.add_done_callback(
                lambda f: say(
                    "cancel answered",
                    code=f.result().return_code,
                    goals=len(f.result().goals_canceling),
                )
            )
            return
        name = line["goal"]
        future = self.client.send_goal_async(goal_of(line), lambda m: self.feedback(name, m))
        future.add_done_callback(lambda f: self.answered(name, f.result()))

    def feedback(self, name, message):
        told = message.feedback
        say(
            "feedback",
            goal=name,
            joints=list(told.joint_names),
            time=told.desired.time_from_start.sec + told.desired.time_from_start.nanosec * 1e-9,
            desired=list(told.desired.positions),
            actual=list(told.actual.positions),
            error=list(told.error.positions),
        )

    def answered(self, name, handle):
        say("answered", goal=name, accepted=handle.accepted)
        if handle.accepted:
            self.handles[name] = handle
            handle.get_result_async().add_done_callback(lambda f: self.ended(name, f.result()))

    def ended(self, name, response):
        result = response.result
        say(
            "result",
            goal=name,
            status=response.status,
            code=result.error_code,
            reason=result.error_string,
        )


def main():
    client = Client()
    todo = []
    threading.Thread(target=lambda: todo.extend(sys.stdin), daemon=True).start()

    def look():
        while todo:
            client.do(json.loads(todo.pop(0)))

    client.client.wait_for_server(30.0)
    say("ready")
    client.node.create_timer(0.002, look)
    rclpy.spin(client.node)


main()
