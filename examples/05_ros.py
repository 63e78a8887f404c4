"""`--ros` in Python: the same program, mirrored to topics; /cmd_vel commands the robot.

ros2 topic echo /joint_states
ros2 topic pub -r 10 /cmd_vel geometry_msgs/msg/Twist "{linear: {x: 0.3}}"
"""

import sys

from unicon_core import load_workflow, run
from unicon_ros.bridge import RosSession

if __name__ == "__main__":
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else None
    session = RosSession(map="default", node_name="unicon")
    program = load_workflow("go2_teleop", hooks=[session.hook])
    report = run(program, session, duration=seconds)
    counts = session.counts()
    print(f"published {counts['published']}, received {counts['received']}, {report.ended}")
