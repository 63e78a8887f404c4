// A T1's end made of the vendor's own code, for booster_robot_peer.py: it tells LowState, hears
// LowCmd, and answers requests for the mode. Built with the headers of BoosterRobotics/booster_robotics_sdk, and
// loaded behind the vendor's Python module, which holds what they declare.

#include <booster/idl/b1/LowCmd.h>
#include <booster/idl/b1/LowState.h>
#include <booster/idl/rpc/RpcReqMsg.h>
#include <booster/idl/rpc/RpcRespMsg.h>
#include <booster/robot/b1/b1_loco_api.hpp>
#include <booster/robot/channel/channel_publisher.hpp>
#include <booster/robot/channel/channel_subscriber.hpp>

#include <algorithm>
#include <array>
#include <atomic>
#include <mutex>
#include <vector>

using namespace booster_interface::msg;
namespace b1 = booster::robot::b1;

namespace {

constexpr int kJoints = 23, kNumbers = 6;
std::mutex mutex;
std::array<float, 2 + kNumbers * kJoints> last{};
std::atomic<int> mode{1};

booster::robot::ChannelPublisher<LowState> *states;
booster::robot::ChannelPublisher<booster_msgs::msg::RpcRespMsg> *answers;

// The vendor's RpcServer is not in its Python module: only its messages and parameters are.
void Asked(const void *message) {
  const auto *asked = static_cast<const booster_msgs::msg::RpcReqMsg *>(message);
  auto json = nlohmann::json::parse(asked->header());
  booster::robot::RequestHeader header;
  header.FromJson(json);
  booster_msgs::msg::RpcRespMsg answer;
  answer.uuid(asked->uuid());
  answer.header(booster::robot::ResponseHeader(0).ToJson().dump());
  if (header.GetApiId() == static_cast<int64_t>(b1::LocoApiId::kChangeMode)) {
    auto body = nlohmann::json::parse(asked->body());
    b1::ChangeModeParameter wanted;
    wanted.FromJson(body);
    mode = static_cast<int>(wanted.mode_);
  } else {
    b1::GetModeResponse told;
    told.mode_ = static_cast<booster::robot::RobotMode>(mode.load());
    answer.body(told.ToJson().dump());
  }
  answers->Write(&answer);
}

void Heard(const void *message) {
  const auto *command = static_cast<const LowCmd *>(message);
  std::lock_guard<std::mutex> guard(mutex);
  last[0] = command->cmd_type();
  last[1] = command->motor_cmd().size();
  for (size_t k = 0; k < std::min<size_t>(command->motor_cmd().size(), kJoints); k++) {
    const MotorCmd &motor = command->motor_cmd()[k];
    const float numbers[] = {motor.q(),  motor.dq(), motor.tau(),
                             motor.kp(), motor.kd(), motor.mode() + motor.weight()};
    std::copy(numbers, numbers + kNumbers, last.begin() + 2 + kNumbers * k);
  }
}

}  // namespace

extern "C" void begin(int domain) {
  booster::robot::ChannelFactory::Instance()->Init(domain, "127.0.0.1");
  states = new booster::robot::ChannelPublisher<LowState>("rt/low_state");
  states->InitChannel();
  answers = new booster::robot::ChannelPublisher<booster_msgs::msg::RpcRespMsg>(
      "rt/LocoApiTopicResp", true);
  answers->InitChannel();
  static booster::robot::ChannelSubscriber<LowCmd> commands("rt/joint_ctrl", Heard);
  commands.InitChannel();
  static booster::robot::ChannelSubscriber<booster_msgs::msg::RpcReqMsg> requests(
      "rt/LocoApiTopicReq", Asked, true);
  requests.InitChannel();
}

extern "C" int mode_now() { return mode; }

extern "C" void heard(float *out) {
  std::lock_guard<std::mutex> guard(mutex);
  std::copy(last.begin(), last.end(), out);
}

// imu: rpy, gyro, acc; q, dq, ddq, tau of each motor; temperature, lost and reserve of each.
extern "C" void tell(const float *imu, const float *numbers, const uint32_t *words, int cranks) {
  std::array<float, 3> parts[3];
  for (int k = 0; k < 9; k++) parts[k / 3][k % 3] = imu[k];
  ImuState sensor;
  sensor.rpy(parts[0]);
  sensor.gyro(parts[1]);
  sensor.acc(parts[2]);
  std::vector<MotorState> motors;
  for (int k = 0; k < kJoints; k++, numbers += 4, words += 4) {
    MotorState motor;
    motor.mode(1);
    motor.q(numbers[0]);
    motor.dq(numbers[1]);
    motor.ddq(numbers[2]);
    motor.tau_est(numbers[3]);
    motor.temperature(words[0]);
    motor.lost(words[1]);
    motor.reserve({words[2], words[3]});
    motors.push_back(motor);
  }
  LowState state;
  state.imu_state(sensor);
  state.motor_state_serial(motors);
  motors.resize(cranks);
  state.motor_state_parallel(motors);
  states->Write(&state);
}
