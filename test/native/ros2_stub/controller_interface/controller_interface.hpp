// As much of ros2_control's interface as unicon_controller.cpp uses, to run it without ROS.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#define RCLCPP_ERROR(logger, ...) (fprintf(stderr, __VA_ARGS__), (void)(logger))

namespace rclcpp {
struct Time {
  int64_t count = 0;
  Time() = default;
  explicit Time(int64_t nanoseconds) : count(nanoseconds) {}
  int64_t nanoseconds() const { return count; }
};
struct Duration {};
template <class T> struct Subscription { using SharedPtr = std::shared_ptr<Subscription>; };
struct Parameter {
  std::string text;
  std::string as_string() const { return text; }
};
struct Node {
  std::map<std::string, std::string> texts;
  Parameter get_parameter(const std::string& name) { return {texts.at(name)}; }
  int get_logger() const { return 0; }
  Time now() const { return {}; }
  template <class T, class Call>
  std::shared_ptr<Subscription<T>> create_subscription(const char*, int, Call call) {
    std::function<void(const T&)> heard = call;
    return std::make_shared<Subscription<T>>();
  }
};
}  // namespace rclcpp

namespace rclcpp_lifecycle {
struct State {};
}  // namespace rclcpp_lifecycle

namespace controller_interface {
enum class CallbackReturn { SUCCESS, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { INDIVIDUAL };
struct InterfaceConfiguration {
  interface_configuration_type type;
  std::vector<std::string> names;
};
struct Interface {
  std::string name;
  double* value;
  const std::string& get_name() const { return name; }
  std::optional<double> get_optional() const { return *value; }
  bool set_value(double wanted) { return *value = wanted, true; }
};
struct ControllerInterface {
  std::shared_ptr<rclcpp::Node> node = std::make_shared<rclcpp::Node>();
  std::vector<Interface> state_interfaces_, command_interfaces_;
  virtual ~ControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State&) = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State&) = 0;
  virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State&) = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual return_type update(const rclcpp::Time&, const rclcpp::Duration&) = 0;
  std::shared_ptr<rclcpp::Node> get_node() { return node; }
  template <class T> void auto_declare(const char* name, const T& value) {
    node->texts[name] = value;
  }
};
}  // namespace controller_interface
