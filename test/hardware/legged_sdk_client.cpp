// A client of the vendor's unitree_legged_sdk, driven by stdin: see test_legged_sdk.py.
// A line of 60 numbers (q, dq, tau, Kp, Kd of 12 motors) is sent; an empty one receives and prints.
#include "unitree_legged_sdk/udp.h"

#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <sstream>
#include <string>

using namespace UNITREE_LEGGED_SDK;

int main(int, char **arguments) {
  const int sent = std::atoi(arguments[3]), received = std::atoi(arguments[4]);
  UDP udp(std::atoi(arguments[1]), "127.0.0.1", std::atoi(arguments[2]), sent, received);
  LowCmd command = {};
  LowState state = {};
  udp.InitCmdData(command);
  command.levelFlag = LOWLEVEL;
  std::string line;
  while (std::getline(std::cin, line)) {
    if (!line.empty()) {
      std::istringstream numbers(line);
      for (int i = 0; i < 12; ++i) {
        auto &motor = command.motorCmd[i];
        numbers >> motor.q >> motor.dq >> motor.tau >> motor.Kp >> motor.Kd;
      }
      udp.SetSend(command);
      udp.Send();
      continue;
    }
    udp.Recv();
    udp.GetRecv(state);
    std::printf("state %u", static_cast<unsigned>(state.tick));
    for (int i = 0; i < 12; ++i) {
      const auto &motor = state.motorState[i];
      std::printf(" %d %.9g %.9g %.9g %d", motor.mode, motor.q, motor.dq, motor.tauEst,
                  motor.temperature);
    }
    const auto &imu = state.imu;
    for (int i = 0; i < 4; ++i) std::printf(" %.9g", imu.quaternion[i]);
    for (int i = 0; i < 3; ++i) std::printf(" %.9g", imu.gyroscope[i]);
    for (int i = 0; i < 3; ++i) std::printf(" %.9g", imu.accelerometer[i]);
    for (int i = 0; i < 40; ++i) std::printf(" %d", state.wirelessRemote[i]);
    std::printf(" %llu\n", static_cast<unsigned long long>(udp.udpState.RecvCRCError));
    std::fflush(stdout);
  }
}
