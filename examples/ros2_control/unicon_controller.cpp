// An exported controller as a controller of ros2_control (Jazzy or newer): measures by the joints'
// state interfaces, commands their efforts. The policy's tick runs each UNICON_PERIOD, the law
// effort = ff + stiffness (target - pos) + damping (vel_target - vel) in every update.
//
// Interfaces: JOINT/position, JOINT/velocity, IMU/orientation.{w,x,y,z},
// IMU/angular_velocity.{x,y,z}, IMU/linear_acceleration.{x,y,z}; commands JOINT/effort.
// It subscribes to ~/cmd_vel.
#include "controller.h"

#include <array>
#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "controller_interface/controller_interface.hpp"
#include "geometry_msgs/msg/twist.hpp"
#include "pluginlib/class_list_macros.hpp"

namespace unicon {

using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;
using geometry_msgs::msg::Twist;

const std::vector<std::string> JOINTS = UNICON_JOINT_NAMES;
constexpr int64_t PERIOD_NS = static_cast<int64_t>(UNICON_PERIOD * 1e9 + 0.5);
constexpr int64_t DAMPING_NS = 500000000;   // after a fault, then the controller manager stops it
constexpr int64_t SILENCE_NS = 500000000;   // of cmd_vel, then zero

// States that this controller fills in, in front of unicon_step.
struct Measured {
  std::vector<float> joint_pos, joint_vel;                           // [rad], [rad/s]
  std::array<float, 4> base_quat;                                    // w, x, y, z
  std::array<float, 3> base_ang_vel, base_lin_acc, projected_gravity, velocity_command;
  int64_t stamp_ns;

  // Return where an input lies, NULL where there is none of that name.
  const void* at(const std::string& name) const {
    if (name == "joint_pos") return joint_pos.data();
    if (name == "joint_vel") return joint_vel.data();
    if (name == "base_quat") return base_quat.data();
    if (name == "base_ang_vel") return base_ang_vel.data();
    if (name == "base_lin_acc") return base_lin_acc.data();
    if (name == "projected_gravity") return projected_gravity.data();
    if (name == "velocity_command") return velocity_command.data();
    if (name == "stamp_ns") return &stamp_ns;
    return nullptr;
  }
};

class UniconController : public controller_interface::ControllerInterface {
 public:
  CallbackReturn on_init() override {
    auto_declare<std::string>("onnxruntime", "libonnxruntime.so");
    auto_declare<std::string>("folder", "");  // of the exported networks
    auto_declare<std::string>("imu", "imu_sensor");
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_configure(const rclcpp_lifecycle::State&) override {
    const auto text = [&](const char* name) { return get_node()->get_parameter(name).as_string(); };
    imu_ = text("imu");
    measured_.joint_pos.resize(JOINTS.size());
    measured_.joint_vel.resize(JOINTS.size());
    const char* wrong = unicon_open(text("onnxruntime").c_str(), text("folder").c_str());
    if (wrong) return refused(wrong);
#define KNOWN(field) if (!measured_.at(#field)) return refused("input " #field " has no interface");
    UNICON_TICK_INPUT(KNOWN)
    subscription_ = get_node()->create_subscription<Twist>(
        "~/cmd_vel", 1, [this](const Twist& message) {
          velocity_[0] = static_cast<float>(message.linear.x);
          velocity_[1] = static_cast<float>(message.linear.y);
          velocity_[2] = static_cast<float>(message.angular.z);
          heard_ns_ = get_node()->now().nanoseconds();
        });
    return CallbackReturn::SUCCESS;
  }

  InterfaceConfiguration command_interface_configuration() const override {
    InterfaceConfiguration wanted{interface_configuration_type::INDIVIDUAL, {}};
    for (const auto& joint : JOINTS) wanted.names.push_back(joint + "/effort");
    return wanted;
  }

  InterfaceConfiguration state_interface_configuration() const override {
    InterfaceConfiguration wanted{interface_configuration_type::INDIVIDUAL, {}};
    for (const auto& joint : JOINTS) wanted.names.push_back(joint + "/position");
    for (const auto& joint : JOINTS) wanted.names.push_back(joint + "/velocity");
    for (const char* each : {"orientation.w", "orientation.x", "orientation.y", "orientation.z",
                             "angular_velocity.x", "angular_velocity.y", "angular_velocity.z",
                             "linear_acceleration.x", "linear_acceleration.y",
                             "linear_acceleration.z"})
      wanted.names.push_back(imu_ + "/" + each);
    return wanted;
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State&) override {
    if (!ordered(state_interface_configuration().names, state_interfaces_, states_) ||
        !ordered(command_interface_configuration().names, command_interfaces_, efforts_))
      return refused("an interface is missing");
    unicon_reset();
    due_ns_ = faulty_ns_ = 0;
    result_ = 0;
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_deactivate(const rclcpp_lifecycle::State&) override {
    for (size_t i : efforts_) (void)command_interfaces_[i].set_value(0.0);
    return CallbackReturn::SUCCESS;
  }

  return_type update(const rclcpp::Time& time, const rclcpp::Duration&) override {
    const int64_t now_ns = time.nanoseconds();
    measure(now_ns);
    if (now_ns >= due_ns_ && result_ != UNICON_DONE) {
      due_ns_ = due_ns_ && now_ns - due_ns_ < PERIOD_NS ? due_ns_ + PERIOD_NS : now_ns + PERIOD_NS;
      unicon_tick_input input;
#define TAKE(field) std::memcpy(&input.field, measured_.at(#field), sizeof input.field);
      UNICON_TICK_INPUT(TAKE)
      result_ = unicon_step(&input, &output_);
      if (result_ > 0 && !faulty_ns_) {
        faulty_ns_ = now_ns;
        RCLCPP_ERROR(get_node()->get_logger(), "fault of block %s", unicon_block_name(result_));
      }
    }
    bool sent = true;
    for (size_t i = 0; i < JOINTS.size(); ++i) {
      const double off = output_.joint_pos_target[i] - measured_.joint_pos[i];
      const double slow = output_.joint_vel_target[i] - measured_.joint_vel[i];
      const double effort = output_.joint_effort_ff[i] + output_.joint_stiffness[i] * off +
                            output_.joint_damping[i] * slow;
      sent &= command_interfaces_[efforts_[i]].set_value(std::isfinite(effort) ? effort : 0.0);
    }
    const bool over = faulty_ns_ && now_ns - faulty_ns_ > DAMPING_NS;
    return sent && !over ? return_type::OK : return_type::ERROR;
  }

 private:
  CallbackReturn refused(const std::string& why) {
    RCLCPP_ERROR(get_node()->get_logger(), "%s", why.c_str());
    return CallbackReturn::ERROR;
  }

  // Find interfaces by name; the controller manager may give them in another order.
  template <class Interfaces>
  static bool ordered(const std::vector<std::string>& names, const Interfaces& given,
                      std::vector<size_t>& places) {
    places.clear();
    for (const auto& name : names)
      for (size_t i = 0; i < given.size(); ++i)
        if (given[i].get_name() == name) places.push_back(i);
    return places.size() == names.size();
  }

  // A value that cannot be read is NaN, which block `finite` or unicon_step itself finds.
  void read(float* values, size_t count, size_t& next) const {
    for (size_t i = 0; i < count; ++i)
      values[i] = static_cast<float>(state_interfaces_[states_[next++]].get_optional().value_or(
          std::numeric_limits<double>::quiet_NaN()));
  }

  void measure(int64_t now_ns) {
    size_t next = 0;
    read(measured_.joint_pos.data(), JOINTS.size(), next);
    read(measured_.joint_vel.data(), JOINTS.size(), next);
    read(measured_.base_quat.data(), 4, next);
    read(measured_.base_ang_vel.data(), 3, next);
    read(measured_.base_lin_acc.data(), 3, next);
    const auto [w, x, y, z] = measured_.base_quat;
    measured_.projected_gravity = {2 * (w * y - x * z), -2 * (w * x + y * z),
                                   2 * (x * x + y * y) - 1};
    measured_.stamp_ns = now_ns;
    const bool heard = now_ns - heard_ns_ < SILENCE_NS;
    for (size_t i = 0; i < 3; ++i)
      measured_.velocity_command[i] = heard ? velocity_[i].load() : 0.0f;
  }

  std::string imu_;
  Measured measured_{};
  unicon_tick_output output_{};
  std::vector<size_t> states_, efforts_;
  int64_t due_ns_ = 0, faulty_ns_ = 0;
  int result_ = 0;
  std::array<std::atomic<float>, 3> velocity_{};
  std::atomic<int64_t> heard_ns_{-SILENCE_NS};
  rclcpp::Subscription<Twist>::SharedPtr subscription_;
};

}  // namespace unicon

PLUGINLIB_EXPORT_CLASS(unicon::UniconController, controller_interface::ControllerInterface)
