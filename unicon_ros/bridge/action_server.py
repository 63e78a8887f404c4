"""ActionServer: a ROS action that ticks work off, served in their slack; for `Trajectories`.

An action is three services and two topics (https://design.ros2.org/articles/actions.html). Made of
those it is served in pieces like all services; rclpy's own server needs an executor, which looks at
all that a node has, and runs each goal in a coroutine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from unicon_ros import compat

ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(1, 7)
"""action_msgs/msg/GoalStatus."""
# `return_code` of action_msgs/srv/CancelGoal.
_NONE, _REJECTED, _UNKNOWN, _TERMINATED = range(4)

MOST_GOALS = 32
"""Goals that are remembered; the oldest that has ended is forgotten first."""


@dataclass(eq=False)
class Goal:
    """One goal.

    Attributes:
        number: its UUID.
        request: the action's goal message.
        stamp: when it was accepted, builtin_interfaces/msg/Time.
        status: of action_msgs/msg/GoalStatus.
        result: the action's result message, once it has ended.
        waiting: headers of requests for the result.
    """

    number: bytes
    request: Any
    stamp: Any
    status: int = ACCEPTED
    result: Any = None
    waiting: list[Any] = field(default_factory=list)

    @property
    def ended(self) -> bool:
        """Whether it has a result."""
        return self.status >= SUCCEEDED


class ActionServer:
    """Serves one action; every goal is accepted, so that a refusal can say why in its result.

    Args:
        node: rclpy node.
        kind: the action's Python class.
        name: of the action, relative to the node's namespace.
        begin: takes a new goal; it ends it sooner or later.
        cancel: takes a goal that somebody wants to end; it ends it.

    Attributes:
        name: full name.
        received: goals that came.
    """

    def __init__(
        self,
        node: Any,
        kind: Any,
        name: str,
        begin: Callable[[Goal], None],
        cancel: Callable[[Goal], None],
    ) -> None:
        from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
        from rclpy.qos import qos_profile_action_status_default

        self._node, self._kind, self._begin, self._cancel = node, kind, begin, cancel
        self._info, self._status, self._array = GoalInfo, GoalStatus, GoalStatusArray
        self._goals: dict[bytes, Goal] = {}
        self.name = str(node.resolve_topic_name(name))
        self.received = 0
        base = f"{name}/_action"
        # The service of the results first: it tells whether the types are complete.
        self._results = node.create_service(
            kind.Impl.GetResultService, f"{base}/get_result", self._asked
        )
        self._send_result = self._results.send_response
        self._results.send_response = self._answer_result
        self._sent = node.create_service(kind.Impl.SendGoalService, f"{base}/send_goal", self._new)
        self._stops = node.create_service(
            kind.Impl.CancelGoalService, f"{base}/cancel_goal", self._stop
        )
        take, self._let_go = compat.request_take(self._stops)
        self._take = take or _nothing
        self._late: list[tuple[Any, Any]] = []
        self._feedback = node.create_publisher(kind.Impl.FeedbackMessage, f"{base}/feedback", 10)
        self._statuses = node.create_publisher(
            GoalStatusArray, f"{base}/status", qos_profile_action_status_default
        )

    # -- in ticks -------------------------------------------------------------------------------

    def look(self) -> None:
        """Hear requests to cancel before the commands of this tick; `answer` answers them."""
        taken = self._take()
        if taken is not None:
            request, header = taken
            response = self._stop(request, self._stops.srv_type.Response())
            self._late.append((response, header))

    def answer(self) -> None:
        """Answer what was heard, once the commands have left."""
        while self._late:
            self._stops.send_response(*self._late.pop())

    def tell(self, goal: Goal, feedback: Any) -> None:
        """Publish feedback of a goal."""
        message = self._kind.Impl.FeedbackMessage(feedback=feedback)
        message.goal_id.uuid = list(goal.number)
        self._feedback.publish(message)

    def end(self, goal: Goal, status: int, result: Any) -> None:
        """Give a goal its result; once it has one nothing changes."""
        if goal.ended:
            return
        goal.status, goal.result = status, result
        self._publish_statuses()
        waiting, goal.waiting = goal.waiting, []
        for header in waiting:
            self._results.send_response(self._result(goal), header)

    # -- services -------------------------------------------------------------------------------

    def _new(self, request: Any, response: Any) -> Any:
        number = bytes(request.goal_id.uuid)
        response.accepted = number not in self._goals
        if not response.accepted:
            return response
        self.received += 1
        response.stamp = self._node.get_clock().now().to_msg()
        goal = self._goals[number] = Goal(number, request.goal, response.stamp, EXECUTING)
        for old in [n for n, each in self._goals.items() if each.ended]:
            if len(self._goals) > MOST_GOALS:
                del self._goals[old]
        self._begin(goal)
        if not goal.ended:
            self._publish_statuses()
        return response

    def _stop(self, request: Any, response: Any) -> Any:
        info = request.goal_info
        number, stamp = bytes(info.goal_id.uuid), (info.stamp.sec, info.stamp.nanosec)
        named = self._goals.get(number)
        if any(number) and named is None:
            response.return_code = _UNKNOWN
            return response
        if named is not None and named.ended:
            response.return_code = _TERMINATED
            return response
        everyone = not any(number) and not any(stamp)
        chosen = [
            goal
            for goal in self._goals.values()
            if not goal.ended
            and (
                everyone
                or goal is named
                or (any(stamp) and (goal.stamp.sec, goal.stamp.nanosec) <= stamp)
            )
        ]
        response.return_code = _NONE if chosen else _REJECTED
        for goal in chosen:
            goal.status = CANCELING
            each = self._info(stamp=goal.stamp)
            each.goal_id.uuid = list(goal.number)
            response.goals_canceling.append(each)
        for goal in chosen:
            self._cancel(goal)
        return response

    def _asked(self, request: Any, response: Any) -> Any:
        goal = self._goals.get(bytes(request.goal_id.uuid))
        if goal is None:
            return response  # of status 0, unknown
        return self._result(goal) if goal.ended else goal

    def _answer_result(self, response: Any, header: Any) -> None:
        """Send a result, or keep the request until its goal has one."""
        if isinstance(response, Goal):
            response.waiting.append(header)
        else:
            self._send_result(response, header)

    def _result(self, goal: Goal) -> Any:
        response = self._results.srv_type.Response()
        response.status, response.result = goal.status, goal.result
        return response

    def _publish_statuses(self) -> None:
        message = self._array()
        for goal in self._goals.values():
            each = self._status(status=goal.status)
            each.goal_info.goal_id.uuid = list(goal.number)
            each.goal_info.stamp = goal.stamp
            message.status_list.append(each)
        self._statuses.publish(message)

    @property
    def open(self) -> list[Goal]:
        """Goals without a result."""
        return [goal for goal in self._goals.values() if not goal.ended]

    def close(self) -> None:
        """Destroy services and topics; goals that are open get no result any more."""
        self._take = _nothing
        self._let_go()
        for service in (self._results, self._sent, self._stops):
            self._node.destroy_service(service)
        for publisher in (self._feedback, self._statuses):
            self._node.destroy_publisher(publisher)


def _nothing() -> None:
    return None
