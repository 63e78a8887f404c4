"""A plain rclpy process: prints a summary of each Image, PointCloud2 or CameraInfo that it hears.

Usage: plain_viewer.py TOPIC Image|PointCloud2|CameraInfo [best_effort]. The QoS is ROS's default,
which is reliable, unless told otherwise. Nothing of unicon is imported.
"""

import json
import sys

import numpy as np
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs import msg


def main():
    rclpy.init()
    node = rclpy.create_node("viewer")

    def heard(message):
        line = {
            "stamp": message.header.stamp.sec * 10**9 + message.header.stamp.nanosec,
            "frame": message.header.frame_id,
            "size": [message.width, message.height],
        }
        if sys.argv[2] == "CameraInfo":
            line |= {"k": message.k.tolist(), "model": message.distortion_model}
        elif sys.argv[2] == "Image" and message.encoding == "rgb8":
            pixels = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)
            line["upper"] = pixels[: message.height // 4].mean(axis=(0, 1)).tolist()
            line["lower"] = pixels[-message.height // 4 :].mean(axis=(0, 1)).tolist()
        else:
            data = np.frombuffer(bytes(message.data), np.float32)
            line["values"] = data.reshape(message.height, message.width, -1)[-1].tolist()
            line["finite"] = float(np.isfinite(data).mean())
        print(json.dumps(line).replace("NaN", "null"), flush=True)

    qos = 10
    if sys.argv[3:] == ["best_effort"]:
        qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(getattr(msg, sys.argv[2]), sys.argv[1], heard, qos)
    print(json.dumps({"ready": True}), flush=True)
    rclpy.spin(node)


main()
