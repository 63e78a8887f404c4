"""Process of a controller with a thread that spins, as UniCon bridges ROS: `spin_once`, then sleep.

Our own baseline of that style: one message is taken for each pass of the spinning thread, so a
queue of depth 10 stays full of old states. The loop runs at its rate beside it and sends.
"""

from __future__ import annotations

import threading
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor

from unicon_ros.bench.pipelines.log import Log, Stop, arguments
from unicon_ros.bench.pipelines.plain_nodes import Controller

SPIN_PERIOD = 0.002  # s between two passes of the spinning thread


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop, log = Stop(), Log(options.out, "stamp", "seen", "begin", "end")
    node = Controller(options.joints, options.best_effort, log, depth=10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin() -> None:
        while not stop:
            executor.spin_once(timeout_sec=0.0)
            time.sleep(SPIN_PERIOD)

    thread = threading.Thread(target=spin)
    thread.start()
    period = 1.0 / options.rate
    due = time.monotonic() + period
    while not stop:
        time.sleep(max(0.0, due - time.monotonic()))
        due = max(due + period, time.monotonic())
        node.send()
    thread.join()
    log.save()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
