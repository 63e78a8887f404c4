"""The fast robot of the benchmarks, with a queue of 50 commands: one that is late is not lost."""

from __future__ import annotations

from rclpy.qos import QoSProfile

from unicon_ros.bench.pipelines import fast_robot, plain


def deep(best_effort: bool) -> QoSProfile:
    return plain.qos(best_effort, depth=50)


fast_robot.qos = deep
fast_robot.main()
