/* A CANopen manager in C with a PID, for a drive as canrig emulates it: it starts the drive, sends SYNC, and commands a current. */
#include "canrig.h"

#include <math.h>

enum { OWN = 0x01, NMT = 0x000, SYNC = 0x080, POSITION = 0x180, COMMAND = 0x200, SDO_ANSWER = 0x580, SDO_ASK = 0x600, HEARTBEAT = 0x700 };
enum { OPERATIONAL = 5, HEARTBEAT_NS = 20000000, RETRY_NS = 500000000, LOOK_NS = 10000000 };

static canrig   bus;
static char     part[16 << 20]; /* what this node may know of the plan */
static int      drive;
static uint64_t period_ns;

static void send_frame(uint32_t id, const uint8_t *data, int length) {
    canrig_frame frame = {0};
    frame.id = id;
    frame.length = (uint8_t)length;
    if (length) memcpy(frame.data, data, (size_t)length);
    canrig_send(&bus, &frame);
}

static void send_nmt(int order) { send_frame(NMT, (uint8_t[]){(uint8_t)order, 0}, 2); }

/* An expedited SDO download (CiA 301, 7.2.4.3.3). */
static void write_object(uint16_t index, uint8_t sub_index, uint32_t value, int bytes) {
    uint8_t request[8] = {(uint8_t)(0x23 | (4 - bytes) << 2), (uint8_t)index, (uint8_t)(index >> 8), sub_index};
    for (int i = 0; i < bytes; i++) request[4 + i] = (uint8_t)(value >> 8 * i);
    send_frame((uint32_t)(SDO_ASK + drive), request, 8);
}

static void command(uint16_t controlword, double amperes) {
    int16_t permille = (int16_t)lrint(1000 * amperes);
    uint8_t data[4] = {(uint8_t)controlword, (uint8_t)(controlword >> 8), (uint8_t)permille, (uint8_t)((uint16_t)permille >> 8)};
    send_frame((uint32_t)(COMMAND + drive), data, 4);
}

/* The controlword towards Operation enabled (CiA 402-2, table 30). */
static uint16_t towards_enabled(uint16_t statusword) {
    if ((statusword & 0x4F) == 0x40) return 0x06; /* switch on disabled */
    if ((statusword & 0x6F) == 0x21) return 0x07; /* ready to switch on */
    if ((statusword & 0x4F) == 0x08) return 0x80; /* fault */
    return 0x0F;
}

/* A number of the part, by its key. */
static double number(const char *key) {
    const char *at = strstr(part, key);
    return at ? strtod(at + strlen(key), NULL) : 0;
}

/* The second number of a pair in the part. */
static double number_behind(const char *key) {
    const char *at = strstr(part, key);
    return at && strchr(at, ',') ? strtod(strchr(at, ',') + 1, NULL) : 0;
}

/* The set-point at a time of the scenario: straight lines between rows `[seconds, value]`. */
static double set_point(double seconds) {
    static const char *rest;
    static double      before[2], after[2];
    const char        *key = "\"set_point\":[";
    if (!rest) rest = strstr(part, key) ? strstr(part, key) + strlen(key) - 1 : "";
    while (after[0] <= seconds && rest[0] && rest[1] == '[') {
        char *end;
        memcpy(before, after, sizeof before);
        after[0] = strtod(rest + 2, &end);
        after[1] = strtod(end + 1, &end);
        rest = end + 1;
    }
    if (after[0] <= seconds) return after[1];
    return before[1] + (after[1] - before[1]) * (seconds - before[0]) / (after[0] - before[0]);
}

/* A PID with the derivative on the measurement, in metres and amperes; the integral waits while the current is at its limit. */
static double pid(double wanted, double position, double period) {
    static const double kp = 64.8, ki = 489.0, kd = 3.74, weight = 0.377, pole = 500.0;
    static double integral, filtered = NAN;
    double low = number("\"command_range\":["), high = number_behind("\"command_range\":[");
    if (isnan(filtered)) filtered = position;
    double moved = (1 - exp(-pole * period)) * (position - filtered);
    filtered += moved;
    double current = kp * (weight * wanted - position) + integral - kd * moved / period;
    double error = wanted - position;
    if (!(current >= high && error > 0) && !(current <= low && error < 0)) integral += ki * error * period;
    return current > high ? high : current < low ? low : current;
}

static int      is_up, is_enabled;
static uint64_t sync_at, zero = CANRIG_NEVER; /* of the scenario: the first SYNC after the drive reported Operation enabled */
static int      step;                         /* of the bring-up */

/* One thing after the other, each as the answer to the one before comes. */
static void bring_up(void) {
    switch (step++) {
    case 0: write_object(0x1016, 1, (uint32_t)OWN << 16 | 1000, 4); break; /* it stops when it has not heard us for 1 s */
    case 1: write_object(0x1006, 0, (uint32_t)(period_ns / 1000), 4); break;
    case 2: write_object(0x6060, 0, 10, 1); break; /* cyclic synchronous torque */
    case 3: send_nmt(1); break;
    }
}

static void on_frame(const canrig_frame *frame) {
    if (frame->id == (uint32_t)(HEARTBEAT + drive)) is_up |= frame->length == 1 && frame->data[0] == 0;
    if (frame->id == (uint32_t)(SDO_ANSWER + drive) && frame->data[0] == 0x60 && step < 4) bring_up();
    if (frame->id != (uint32_t)(POSITION + drive) || frame->length < 6) return;
    uint16_t statusword = (uint16_t)(frame->data[0] | frame->data[1] << 8);
    int32_t  micrometres;
    memcpy(&micrometres, frame->data + 2, 4);
    is_enabled = (statusword & 0x6F) == 0x27;
    double current = 0;
    if (is_enabled && zero != CANRIG_NEVER)
        current = pid(1e-3 * set_point((double)(sync_at - zero) / 1e9), 1e-6 * micrometres, (double)period_ns / 1e9);
    command(towards_enabled(statusword), current);
}

static int read_part(void) {
    const char *path = getenv("CANRIG_PART");
    FILE       *file = path ? fopen(path, "r") : NULL;
    if (!file) return -1;
    size_t length = fread(part, 1, sizeof part - 1, file);
    fclose(file);
    const char *node = strstr(part, "\"drive\":{");
    period_ns = (uint64_t)llrint(1e9 * number("\"period_seconds\":"));
    if (!length || !node || !period_ns) return -1;
    drive = atoi(strstr(node, "\"node_id\":") + 10);
    return 0;
}

int main(void) {
    if (read_part()) return fprintf(stderr, "canrig starts this program: CANRIG_PART names no part\n"), 2;
    const canrig_filter filters[] = {CANRIG_EXACT(POSITION + drive), CANRIG_EXACT(SDO_ANSWER + drive), CANRIG_EXACT(HEARTBEAT + drive)};
    const canrig_options options = {"controller", filters, 3, filters + 2, 1, 0};
    int                  opened = canrig_open(&bus, NULL, &options);
    if (opened) return fprintf(stderr, "the bus: %s\n", strerror(-opened)), 1;
    uint64_t start = canrig_now(&bus), next_heartbeat = start, next_sync = CANRIG_NEVER, next_look = start, next_reset = start;
    for (;;) {
        uint64_t now = canrig_now(&bus);
        if (now >= next_heartbeat) {
            send_frame(HEARTBEAT + OWN, (uint8_t[]){OPERATIONAL}, 1);
            while (next_heartbeat <= now) next_heartbeat += HEARTBEAT_NS;
        }
        if (now >= next_sync) {
            sync_at = next_sync;
            if (is_enabled && zero == CANRIG_NEVER) zero = sync_at;
            send_frame(SYNC, NULL, 0);
            while (next_sync <= now) next_sync += period_ns; /* what was missed is skipped */
        }
        if (now >= next_look) { /* for the drive's boot-up, then for the end of the bring-up */
            next_look = now + LOOK_NS;
            if (is_up && step == 0) bring_up();
            if (step == 4) next_sync = now + LOOK_NS, next_look = CANRIG_NEVER;
            if (!is_up && now >= next_reset) {
                send_frame(NMT, (uint8_t[]){130, (uint8_t)drive}, 2);
                next_reset = now + RETRY_NS;
            }
        }
        uint64_t     until = next_heartbeat < next_sync ? next_heartbeat : next_sync;
        canrig_frame frame;
        int          came = canrig_wait(&bus, &frame, until < next_look ? until : next_look);
        if (came == 1) on_frame(&frame);
        if (came == CANRIG_STOP) break;
        if (came == CANRIG_END) return 0;
        if (came < 0) return fprintf(stderr, "the bus: %s\n", strerror(-came)), 1;
    }
    command(0x06, 0); /* shutdown: no current */
    canrig_close(&bus);
    return 0;
}
