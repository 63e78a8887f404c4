#pragma once
namespace geometry_msgs::msg {
struct Vector3 { double x, y, z; };
struct Twist { Vector3 linear, angular; };
}  // namespace geometry_msgs::msg
