// The vendor's libhardware.so (real-stanford/arx5-sdk) on a bus that is ours; for test_arx.py.
//
// Lines of standard input: `E|D kp kd pos vel tor` has it send a command, whose frame is printed;
// `R|M motor frame` has it read an answer of an EC or DM motor, whose figures are printed.
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

struct OD_Motor_Msg { // as include/hardware/arx_can.h
    int16_t current_int;
    float speed, angle;
    uint16_t motor;
    uint8_t temperature, error;
    float angle_float, current, gripper[6];
};
using Messages = std::array<OD_Motor_Msg, 10>;
void RV_can_data_repack(uint32_t, uint8_t *, int32_t, uint8_t, Messages &);
void DM_can_data_repack(uint8_t *, Messages &);
class ArxCan {
    char room[4096];

  public:
    ArxCan(std::string);
    void send_EC_motor_cmd(uint16_t, float, float, float, float, float);
    void send_DM_motor_cmd(uint16_t, float, float, float, float, float);
};

static int bus = -1;
extern "C" {
// EtherCAT, which is not used.
#define UNUSED(name) char name[8]
UNUSED(EcatError); UNUSED(ec_ALstatuscode2string); UNUSED(ec_DCtime); UNUSED(ecx_close);
UNUSED(ecx_config_init); UNUSED(ecx_config_map_group); UNUSED(ecx_configdc); UNUSED(ecx_init);
UNUSED(ecx_readstate); UNUSED(ecx_receive_processdata); UNUSED(ecx_send_processdata);
UNUSED(ecx_statecheck); UNUSED(ecx_writestate);

int socket(int domain, int type, int protocol) {
    if (domain != AF_CAN) return syscall(SYS_socket, domain, type, protocol);
    int ends[2];
    syscall(SYS_socketpair, AF_UNIX, SOCK_DGRAM, 0, ends);
    return bus = ends[0];
}
int ioctl(int, unsigned long, ...) { return 0; }
int bind(int, const struct sockaddr *, socklen_t) { return 0; }
ssize_t write(int fd, const void *data, size_t size) {
    if (fd != bus) return syscall(SYS_write, fd, data, size);
    const uint8_t *frame = static_cast<const uint8_t *>(data); // struct can_frame
    fprintf(stderr, "%02x ", frame[0]);
    for (int i = 0; i < frame[4]; i++) fprintf(stderr, "%02x", frame[8 + i]);
    fprintf(stderr, "\n");
    return size;
}
}

int main() {
    ArxCan *can = new ArxCan("can0");
    char line[256], kind;
    while (fgets(line, sizeof line, stdin)) {
        float kp, kd, pos, vel, torque;
        unsigned motor, byte;
        if (sscanf(line, "%c %f %f %f %f %f", &kind, &kp, &kd, &pos, &vel, &torque) == 6) {
            if (kind == 'E') can->send_EC_motor_cmd(1, kp, kd, pos, vel, torque);
            else can->send_DM_motor_cmd(5, kp, kd, pos, vel, torque);
            continue;
        }
        int at;
        uint8_t data[8];
        sscanf(line, "%c %u %n", &kind, &motor, &at);
        for (int i = 0; i < 8; i++) {
            sscanf(line + at + 2 * i, "%2x", &byte);
            data[i] = byte;
        }
        Messages told;
        memset(static_cast<void *>(&told), 0, sizeof told);
        if (kind == 'R') RV_can_data_repack(motor, data, 8, 0, told);
        else DM_can_data_repack(data, told);
        const OD_Motor_Msg &m = told[motor];
        fprintf(stderr, "%d %.9g %.9g %.9g %d %d\n", m.motor, m.angle, m.speed, m.current,
                m.temperature, m.error);
    }
    _exit(0);
}
