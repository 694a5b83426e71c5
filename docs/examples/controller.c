/* A controller in C for canrig's emulated drive, or any that is mapped like it: CANopen manager, SYNC producer, PI law.
 *
 *   cc -O2 -Wall -o controller controller.c -lm
 *   ./controller INTERFACE PERIOD_MILLISECONDS SECONDS:MILLIMETRES...
 *
 * The set-points are steps at scenario times, the first at 0. Ends with 0 when the drive falls silent.
 */
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <math.h>
#include <net/if.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { CONTROLLER = 0x01, DRIVE = 0x10, FAN = 0x11 };
enum { NMT = 0x000, SYNC = 0x080, HEARTBEAT = 0x700, POSITION = 0x190, COMMAND = 0x210, SDO_ASK = 0x610, SDO_ANSWER = 0x590 };
static const double SILENCE_SECONDS = 2.0, HEARTBEAT_SECONDS = 0.02;

static int bus;

static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec + 1e-9 * time.tv_nsec;
}

static void fail(const char *what) {
    fprintf(stderr, "controller: %s: %s\n", what, errno ? strerror(errno) : "no answer");
    exit(1);
}

static void open_bus(const char *name) {
    struct ifreq interface = {0};
    bus = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    snprintf(interface.ifr_name, sizeof interface.ifr_name, "%s", name);
    if (bus < 0 || ioctl(bus, SIOCGIFINDEX, &interface) < 0) fail(name);
    struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = interface.ifr_ifindex};
    if (bind(bus, (struct sockaddr *)&address, sizeof address) < 0) fail(name);
}

static void send_frame(canid_t id, const uint8_t *data, int length) {
    struct can_frame frame = {.can_id = id, .can_dlc = length};
    memcpy(frame.data, data, length);
    if (write(bus, &frame, sizeof frame) != sizeof frame) fail("cannot send");
}

static int receive(struct can_frame *frame, double until) {
    double left = until - now();
    struct pollfd ready = {.fd = bus, .events = POLLIN};
    if (left <= 0 || poll(&ready, 1, (int)(left * 1e3) + 1) <= 0) return 0;
    return read(bus, frame, sizeof *frame) == sizeof *frame;
}

/* Expedited SDO download (CiA 301, 7.2.4.3.3). */
static void write_object(uint16_t index, uint8_t sub_index, uint32_t value, int bytes) {
    uint8_t request[8] = {0x23 | (4 - bytes) << 2, index & 0xFF, index >> 8, sub_index};
    for (int i = 0; i < bytes; i++) request[4 + i] = value >> 8 * i;
    send_frame(SDO_ASK, request, 8);
    struct can_frame frame;
    for (double until = now() + 3.0; receive(&frame, until);)
        if (frame.can_id == SDO_ANSWER && frame.data[0] == 0x60) return;
    errno = 0;
    fail("the drive does not take an object");
}

/* Resets the drive, waits for its boot-up, tells it how we work, and starts it and the fan. */
static void bring_up(double period) {
    struct can_frame frame;
    int is_up = 0;
    while (!is_up) {
        send_frame(NMT, (uint8_t[]){130, DRIVE}, 2);
        for (double until = now() + 0.5; !is_up && receive(&frame, until);)
            is_up = frame.can_id == HEARTBEAT + DRIVE && frame.data[0] == 0;
    }
    write_object(0x1016, 1, (uint32_t)CONTROLLER << 16 | 1000, 4); /* it stops when it has not heard us for 1 s */
    write_object(0x1006, 0, (uint32_t)(period * 1e6 + 0.5), 4);
    write_object(0x6060, 0, 10, 1); /* cyclic synchronous torque */
    send_frame(NMT, (uint8_t[]){1, DRIVE}, 2);
    send_frame(NMT, (uint8_t[]){1, FAN}, 2);
}

static void command(uint16_t controlword, double amperes) {
    int16_t permille = (int16_t)(1000 * amperes + 0.5);
    send_frame(COMMAND, (uint8_t[]){controlword & 0xFF, controlword >> 8, permille & 0xFF, permille >> 8}, 4);
}

/* Controlword towards Operation enabled (CiA 402-2, table 30). */
static uint16_t next_controlword(uint16_t statusword) {
    if ((statusword & 0x4F) == 0x40) return 0x06; /* switch on disabled */
    if ((statusword & 0x6F) == 0x21) return 0x07; /* ready to switch on */
    if ((statusword & 0x4F) == 0x08) return 0x80; /* fault */
    return 0x0F;
}

/* Current for a set-point: what heats is its square, so PI and speed feedback act on that. A step is followed as a ramp. */
static double law(double set_point, double millimetres, double period) {
    static double reference = 0, integral = 0.21, last = -1;
    double reach = 20.0 * period;
    double towards = set_point - reference;
    reference += towards > reach ? reach : towards < -reach ? -reach : towards;
    double error = reference - millimetres, speed = last < 0 ? 0 : (millimetres - last) / period;
    last = millimetres;
    double square = integral + 0.007 * error - 0.0003 * speed;
    if (square > 0 && square < 1) integral += 0.008 * error * period;
    square = square < 0 ? 0 : square > 1 ? 1 : square;
    return sqrt(square);
}

int main(int count, char **words) {
    if (count < 4) return fprintf(stderr, "usage: %s INTERFACE PERIOD_MILLISECONDS SECONDS:MILLIMETRES...\n", words[0]), 2;
    double period = atof(words[2]) / 1e3, set_point = 0, seconds, millimetres;
    open_bus(words[1]);
    bring_up(period);
    double next_sync = now(), next_heartbeat = now(), heard_at = now();
    long cycle = -1; /* scenario time 0 is the first SYNC after the drive said Operation enabled */
    int is_enabled = 0;
    while (now() < heard_at + SILENCE_SECONDS) {
        if (now() >= next_sync) {
            if (is_enabled) cycle++;
            send_frame(SYNC, NULL, 0);
            next_sync += period;
        }
        if (now() >= next_heartbeat) {
            send_frame(HEARTBEAT + CONTROLLER, (uint8_t[]){5}, 1);
            next_heartbeat += HEARTBEAT_SECONDS;
        }
        struct can_frame frame;
        double until = next_sync < next_heartbeat ? next_sync : next_heartbeat;
        if (!receive(&frame, until) || frame.can_id != POSITION || frame.can_dlc < 6) continue;
        heard_at = now();
        uint16_t statusword = frame.data[0] | frame.data[1] << 8;
        int32_t micrometres;
        memcpy(&micrometres, frame.data + 2, 4);
        is_enabled = (statusword & 0x6F) == 0x27;
        for (int i = 3; i < count; i++)
            if (sscanf(words[i], "%lf:%lf", &seconds, &millimetres) == 2 && seconds <= cycle * period) set_point = millimetres;
        command(next_controlword(statusword), is_enabled && cycle >= 0 ? law(set_point, micrometres / 1e3, period) : 0);
    }
    return 0;
}
