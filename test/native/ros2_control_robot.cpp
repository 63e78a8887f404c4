// A controller manager and a robot for unicon_controller.cpp, without ROS: gives recorded inputs by
// interfaces in another order, and compares efforts. `robot FOLDER ONNXRUNTIME`.
#include <cstdlib>

#include "unicon_controller.cpp"
#include "vectors.h"

struct Robot : unicon::UniconController {
  std::map<std::string, double> values;
  std::string imu = "imu_sensor";

  void give(size_t left_out) {
    state_interfaces_.clear(), command_interfaces_.clear();
    auto states = state_interface_configuration().names;
    auto commands = command_interface_configuration().names;
    for (size_t i = states.size(); i-- > left_out;)
      state_interfaces_.push_back({states[i], &values[states[i]]});
    for (size_t i = commands.size(); i-- > 0;)
      command_interfaces_.push_back({commands[i], &values[commands[i]]});
  }

  void measure_as(const unicon_tick_input& input) {
    for (size_t i = 0; i < unicon::JOINTS.size(); ++i) {
      values[unicon::JOINTS[i] + "/position"] = input.joint_pos[i];
      values[unicon::JOINTS[i] + "/velocity"] = input.joint_vel[i];
    }
    const char* axes[] = {"x", "y", "z"};
    for (int i = 0; i < 3; ++i)
      values[imu + "/angular_velocity." + axes[i]] = input.base_ang_vel[i];
    // A turn that brings gravity to where it was recorded, about an axis in the plane.
    const float* g = input.projected_gravity;
    double w = std::sqrt((1 - g[2]) / 2);
    values[imu + "/orientation.w"] = w;
    values[imu + "/orientation.x"] = -g[1] / (2 * w);
    values[imu + "/orientation.y"] = g[0] / (2 * w);
  }
};

int main(int, char** words) {
  std::string folder = words[1];
  auto [inputs, outputs] = Vectors(folder);
  const size_t ticks = inputs.size();
  Robot robot;
  using unicon::CallbackReturn;
  using unicon::return_type;
  CHECK(robot.on_init() == CallbackReturn::SUCCESS);
  robot.node->texts["folder"] = "/nowhere";
  CHECK(robot.on_configure({}) == CallbackReturn::ERROR);
  robot.node->texts["folder"] = folder;
  robot.node->texts["onnxruntime"] = words[2];
  CHECK(robot.on_configure({}) == CallbackReturn::SUCCESS);
  robot.give(1);
  CHECK(robot.on_activate({}) == CallbackReturn::ERROR);
  robot.give(0);
  CHECK(robot.on_activate({}) == CallbackReturn::SUCCESS);
  auto effort = [&](size_t i) { return robot.values[unicon::JOINTS[i] + "/effort"]; };
  double worst = 0;
  int64_t now = 1000000000;
  const int64_t step = unicon::PERIOD_NS / 5;  // the controller manager runs five times as often
  for (size_t tick = 0; tick < ticks; ++tick)
    for (int part = 0; part < 5; ++part, now += step) {
      const unicon_tick_input& in = inputs[tick];
      const unicon_tick_output& out = outputs[tick];
      robot.measure_as(in);
      CHECK(robot.update(rclcpp::Time(now), {}) == return_type::OK);
      for (size_t i = 0; i < unicon::JOINTS.size(); ++i) {
        double off = out.joint_pos_target[i] - in.joint_pos[i];
        double slow = out.joint_vel_target[i] - in.joint_vel[i];
        double wanted = out.joint_effort_ff[i] + out.joint_stiffness[i] * off +
                        out.joint_damping[i] * slow;
        worst = std::max(worst, std::abs(wanted - effort(i)));
      }
    }
  printf("%zu ticks, largest difference %.1e N m\n", ticks, worst);
  CHECK(worst < 1e-3);
  robot.values[unicon::JOINTS[0] + "/position"] = std::nan("");  // a fault: it damps, then ends
  int64_t fault = now;
  for (; now < fault + unicon::DAMPING_NS; now += step) {
    CHECK(robot.update(rclcpp::Time(now), {}) == return_type::OK);
    for (size_t i = 0; i < unicon::JOINTS.size(); ++i) CHECK(std::isfinite(effort(i)));
  }
  for (size_t i = 1; i < unicon::JOINTS.size(); ++i)  // no stiffness any more
    CHECK(effort(i) * robot.values[unicon::JOINTS[i] + "/velocity"] <= 0);
  CHECK(robot.update(rclcpp::Time(now + step), {}) == return_type::ERROR);
  CHECK(robot.on_deactivate({}) == CallbackReturn::SUCCESS);
  for (size_t i = 0; i < unicon::JOINTS.size(); ++i) CHECK(effort(i) == 0);
  return failures != 0;
}
