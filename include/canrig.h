/*
 * A node in C for canrig: a controller, a drive or an io node, from one source in every world. In virtual time (CANRIG_BUS is
 * `lockstep:/path`) it plays repeatably, at the speed of the machine; in real time (`embedded:/path`, `can0`, `vcan0`) by the clock.
 *
 *     cc -O2 -I include -o controller controller.c
 *
 * C99 on Linux, one header, no allocation. Include it first: it asks for what POSIX and Linux add to C. One thread. The book has the
 * protocol below ("Seats of programs") and a controller that uses this ("A node in any language").
 */
#ifndef CANRIG_H
#define CANRIG_H

#ifndef _GNU_SOURCE
#define _GNU_SOURCE 1
#endif

#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <pthread.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "canrig.h is for little-endian machines"
#endif

/* A frame; `id` with the kernel's bits (CAN_EFF_FLAG, CAN_RTR_FLAG, CAN_ERR_FLAG). `flags` are 0, and `length` is at most 8. */
typedef struct {
    uint64_t time_ns;
    uint32_t id;
    uint8_t  length, flags;
    uint16_t reserved;
    uint8_t  data[64];
} canrig_frame;

/* As the kernel's: a frame passes if its identifier equals `id` in the bits of `mask`. */
typedef struct {
    uint32_t id, mask;
} canrig_filter;

/* The data frame with this identifier: of 11 bits, or of 29 bits with CAN_EFF_FLAG. */
#define CANRIG_EXACT(identifier) {(identifier), CAN_EFF_FLAG | CAN_RTR_FLAG | ((identifier) & CAN_EFF_FLAG ? CAN_EFF_MASK : CAN_SFF_MASK)}

/* In the flags of the options: error frames of the bus arrive, too. */
#define CANRIG_ERRORS 2u

typedef struct {
    const char          *name;    /* for people, at most 31 bytes */
    const canrig_filter *filters; /* frames that arrive */
    size_t               filters_count;
    const canrig_filter *silent; /* those of them that make it neither send nor wake earlier: fewer questions in virtual time */
    size_t               silent_count;
    unsigned             flags;
} canrig_options;

/* What canrig_wait returns besides 0, 1 and -errno. */
#define CANRIG_STOP 2 /* once: bring the outputs to a safe state, then close; 0.5 s of virtual time are left for it */
#define CANRIG_END 3  /* canrig is gone, or the bus is */
/* What canrig_send returns besides 0 and -errno. */
#define CANRIG_FULL 1 /* no room: wait, and send again */

#define CANRIG_FILTERS_MAX 512
#define CANRIG_FRAMES_MAX 1024
#define CANRIG_MESSAGE_MAX 131072
#define CANRIG_NEVER UINT64_MAX

/* A bus. Its memory is the caller's: make it `static`, it has 160 KB. */
typedef struct {
    uint64_t      seed; /* of the run, in virtual time */
    uint32_t      bits_per_second;
    uint8_t       node_id;
    /* What follows is nobody else's business. */
    int           kind, channel, lifeline, is_asked, is_stopping, is_over, may_go_on;
    unsigned      idle;
    pthread_t     thread;
    uint64_t      now, to, until, end;
    uint32_t      number;
    size_t        records, record, queued;
    uint8_t       quiet[256]; /* a bit for each identifier of 11 bits whose frames nobody answers */
    uint8_t       in[CANRIG_MESSAGE_MAX];
    uint8_t       out[24 + 24 * CANRIG_FRAMES_MAX + 1024];
} canrig;

enum { CANRIG_LOCKSTEP_ = 1, CANRIG_EMBEDDED_, CANRIG_INTERFACE_ };
enum { CANRIG_HELLO_ = 1, CANRIG_WELCOME_, CANRIG_GRANT_, CANRIG_DONE_, CANRIG_STOP_ };

static inline uint64_t canrig_clock_(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (uint64_t)time.tv_sec * 1000000000u + (uint64_t)time.tv_nsec;
}

static inline void canrig_put_(uint8_t *at, uint64_t value, int bytes) { memcpy(at, &value, (size_t)bytes); }

static inline uint64_t canrig_get_(const uint8_t *at, int bytes) {
    uint64_t value = 0;
    memcpy(&value, at, (size_t)bytes);
    return value;
}

static inline void canrig_header_(uint8_t *at, int kind, int a, size_t count, uint32_t number, uint64_t time) {
    at[0] = (uint8_t)kind;
    at[1] = (uint8_t)a;
    canrig_put_(at + 2, count, 2);
    canrig_put_(at + 4, number, 4);
    canrig_put_(at + 8, time, 8);
}

/* Whether nobody answers a frame. Remote frames and extended ones may always be answered. */
/* Whether an identifier has more than 11 bits, and no CAN_EFF_FLAG: its bits would be cut. */
static inline int canrig_is_cut_(uint32_t id) { return !(id & CAN_EFF_FLAG) && (id & CAN_EFF_MASK) > CAN_SFF_MASK; }

/* Whether a filter is CANRIG_EXACT of such an identifier: it takes the frame with the bits that are left. */
static inline int canrig_takes_another_(const canrig_filter *filter) {
    return canrig_is_cut_(filter->id) && filter->mask == (CAN_EFF_FLAG | CAN_RTR_FLAG | CAN_SFF_MASK);
}

static inline int canrig_is_quiet_(const canrig *bus, uint32_t id) { return id <= CAN_SFF_MASK && bus->quiet[id / 8] >> id % 8 & 1; }

/* Notes that nobody answers the frames that pass a filter. */
static inline void canrig_add_quiet_(canrig *bus, uint32_t wanted, uint32_t mask) {
    for (uint32_t id = 0; id <= CAN_SFF_MASK; id++)
        if ((id & mask) == (wanted & mask)) bus->quiet[id / 8] |= (uint8_t)(1 << id % 8);
}

static inline ssize_t canrig_receive_(canrig *bus, int flags) {
    ssize_t length;
    do length = recv(bus->channel, bus->in, sizeof bus->in, flags);
    while (length < 0 && errno == EINTR);
    if (length < 0 && errno == ECONNRESET) length = 0;
    return length < 0 ? -errno : length;
}

static inline int canrig_connect_(const char *path) {
    struct sockaddr_un address;
    memset(&address, 0, sizeof address);
    address.sun_family = AF_UNIX;
    if (strlen(path) >= sizeof address.sun_path) return -ENAMETOOLONG;
    memcpy(address.sun_path, path, strlen(path));
    int channel = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
    if (channel < 0) return -errno;
    if (connect(channel, (struct sockaddr *)&address, sizeof address) < 0) {
        int error = errno;
        close(channel);
        return -error;
    }
    return channel;
}

static inline int canrig_greet_(canrig *bus, const canrig_options *options) {
    uint8_t *hello = bus->in;
    size_t   filters = options->filters_count, silent = options->silent_count, bytes = sizeof(canrig_filter);
    memset(hello, 0, 56);
    canrig_header_(hello, CANRIG_HELLO_, 1, filters, 0x47495243u, 0);
    hello[17] = (uint8_t)options->flags;
    canrig_put_(hello + 18, silent, 2);
    if (options->name) strncpy((char *)hello + 24, options->name, 31);
    if (filters) memcpy(hello + 56, options->filters, filters * bytes);
    if (silent) memcpy(hello + 56 + filters * bytes, options->silent, silent * bytes);
    if (send(bus->channel, hello, 56 + (filters + silent) * bytes, MSG_NOSIGNAL) < 0) return -errno;
    ssize_t length = canrig_receive_(bus, 0);
    if (length < 0) return (int)length;
    size_t quiet = length >= 40 ? canrig_get_(bus->in + 2, 2) : 0;
    if (length < 40 || bus->in[0] != CANRIG_WELCOME_ || quiet > CANRIG_FILTERS_MAX || (size_t)length != 40 + quiet * bytes) return -EPROTO;
    bus->now = canrig_get_(bus->in + 8, 8);
    bus->bits_per_second = (uint32_t)canrig_get_(bus->in + 16, 4);
    bus->seed = canrig_get_(bus->in + 24, 8);
    bus->node_id = bus->in[32];
    for (size_t i = 0; i < quiet; i++) canrig_add_quiet_(bus, (uint32_t)canrig_get_(bus->in + 40 + i * bytes, 4), (uint32_t)canrig_get_(bus->in + 44 + i * bytes, 4));
    return 0;
}

static inline int canrig_join_(canrig *bus, const canrig_options *options) {
    static const canrig_filter none = {0, CAN_ERR_FLAG};
    size_t                     count = options->filters_count;
    if (options->flags & CANRIG_ERRORS) {
        canrig_filter *filters = (canrig_filter *)(void *)bus->out;
        if (count) memcpy(filters, options->filters, count * sizeof *filters);
        filters[count].id = 0;
        filters[count].mask = CAN_ERR_FLAG | CAN_ERR_MASK;
        if (send(bus->channel, filters, (count + 1) * sizeof *filters, MSG_NOSIGNAL) < 0) return -errno;
    } else if (send(bus->channel, count ? options->filters : &none, (count ? count : 1) * sizeof none, MSG_NOSIGNAL) < 0) {
        return -errno;
    }
    ssize_t length = canrig_receive_(bus, 0);
    return length < 0 ? (int)length : length == 8 ? 0 : -EPROTO;
}

static inline int canrig_bind_(canrig *bus, const char *name, const canrig_options *options) {
    struct ifreq        interface;
    struct sockaddr_can address;
    can_err_mask_t      errors = CAN_ERR_MASK;
    memset(&interface, 0, sizeof interface);
    memset(&address, 0, sizeof address);
    if (strlen(name) >= sizeof interface.ifr_name) return -ENODEV;
    memcpy(interface.ifr_name, name, strlen(name));
    bus->channel = socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW);
    if (bus->channel < 0 || ioctl(bus->channel, SIOCGIFINDEX, &interface) < 0) return -errno;
    address.can_family = AF_CAN;
    address.can_ifindex = interface.ifr_ifindex;
    socklen_t length = (socklen_t)(options->filters_count * sizeof(canrig_filter));
    if (setsockopt(bus->channel, SOL_CAN_RAW, CAN_RAW_FILTER, options->filters, length) < 0) return -errno;
    if (options->flags & CANRIG_ERRORS && setsockopt(bus->channel, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors) < 0) return -errno;
    return bind(bus->channel, (struct sockaddr *)&address, sizeof address) < 0 ? -errno : 0;
}

/* Receives a question; 0, or what canrig_wait is to return. */
static inline int canrig_ask_(canrig *bus) {
    ssize_t length = canrig_receive_(bus, 0);
    if (length <= 0) {
        bus->is_over = 1;
        return length < 0 ? (int)length : CANRIG_END;
    }
    if (length < 16) return -EPROTO;
    bus->number = (uint32_t)canrig_get_(bus->in + 4, 4);
    bus->to = bus->until = canrig_get_(bus->in + 8, 8);
    bus->is_asked = 1;
    bus->may_go_on = 0;
    bus->records = bus->record = 0;
    if (bus->in[0] == CANRIG_STOP_) {
        bus->is_stopping = 1;
        if (bus->now < bus->to) bus->now = bus->to;
        return CANRIG_STOP;
    }
    bus->records = canrig_get_(bus->in + 2, 2);
    if (bus->in[0] != CANRIG_GRANT_ || (size_t)length != 24 + 24 * bus->records) return -EPROTO;
    bus->until = canrig_get_(bus->in + 16, 8);
    bus->may_go_on = 1;
    if (bus->in[1] & 1 && bus->now < bus->to) bus->now = bus->to; /* it was halted */
    for (size_t i = 0; i < bus->queued; i++)
        if (!canrig_is_quiet_(bus, (uint32_t)canrig_get_(bus->out + 24 + 24 * i + 8, 4))) bus->may_go_on = 0;
    return 0;
}

static inline int canrig_answer_(canrig *bus, int a, uint64_t next, uint64_t reached, const char *text) {
    size_t length = 24 + 24 * bus->queued, words = text ? strnlen(text, 1024) : 0;
    canrig_header_(bus->out, CANRIG_DONE_, a, bus->queued, bus->number, next);
    canrig_put_(bus->out + 16, reached, 8);
    if (words) memcpy(bus->out + length, text, words);
    bus->queued = 0;
    bus->is_asked = 0;
    if (bus->now < reached) bus->now = reached;
    return send(bus->channel, bus->out, length + words, MSG_NOSIGNAL) < 0 ? -errno : 0;
}

static inline void canrig_leave_(canrig *bus, int a, const char *text) {
    if (bus->kind == CANRIG_LOCKSTEP_ && !bus->is_over) {
        int asked = 0;
        while (!bus->is_asked && asked >= 0 && asked != CANRIG_END) asked = canrig_ask_(bus);
        if (bus->is_asked) canrig_answer_(bus, a, CANRIG_NEVER, bus->now, text);
    }
    if (bus->channel >= 0) close(bus->channel);
    bus->channel = -1;
    bus->is_over = 1;
}

/* Opens a bus: NULL is the one that canrig has put into the environment. 0, or -errno. */
static inline int canrig_open(canrig *bus, const char *address, const canrig_options *options) {
    memset(bus, 0, offsetof(canrig, in));
    bus->thread = pthread_self();
    bus->channel = bus->lifeline = -1;
    if (!address) address = getenv("CANRIG_BUS");
    const char *lifeline = getenv("CANRIG_LIFELINE");
    if (!address || !options || options->filters_count >= CANRIG_FILTERS_MAX || options->silent_count > CANRIG_FILTERS_MAX) return -EINVAL;
    for (size_t place = 0; place < options->filters_count; place++)
        if (canrig_takes_another_(options->filters + place)) return -EINVAL;
    for (size_t place = 0; place < options->silent_count; place++)
        if (canrig_takes_another_(options->silent + place)) return -EINVAL;
    int error;
    if (!strncmp(address, "lockstep:", 9)) {
        bus->kind = CANRIG_LOCKSTEP_;
        bus->channel = error = canrig_connect_(address + 9);
        if (error >= 0) error = canrig_greet_(bus, options);
    } else {
        if (lifeline) bus->lifeline = atoi(lifeline);
        bus->now = canrig_clock_();
        if (!strncmp(address, "embedded:", 9)) {
            bus->kind = CANRIG_EMBEDDED_;
            bus->channel = error = canrig_connect_(address + 9);
            if (error >= 0) error = canrig_join_(bus, options);
        } else {
            bus->kind = CANRIG_INTERFACE_;
            error = canrig_bind_(bus, address, options);
        }
    }
    if (error >= 0) return 0;
    bus->is_over = 1;
    canrig_leave_(bus, 0, NULL);
    return error;
}

/* The time, in nanoseconds: of the frame or the wake-up that was last, or of the clock in real time. */
static inline uint64_t canrig_now(const canrig *bus) { return bus->kind == CANRIG_LOCKSTEP_ ? bus->now : canrig_clock_(); }

static inline int canrig_is_other_thread_(const canrig *bus) {
    if (bus->kind != CANRIG_LOCKSTEP_ || pthread_equal(bus->thread, pthread_self())) return 0;
    fprintf(stderr, "canrig: in virtual time the thread that opened the bus is the only one that may use it\n");
    return 1;
}

/* Ends the run, which names this node and says why. */
static inline int canrig_fail(canrig *bus, const char *why) {
    canrig_leave_(bus, 2, why);
    fprintf(stderr, "canrig: %s\n", why);
    return -ECANCELED;
}

/* Leaves the bus. */
static inline void canrig_close(canrig *bus) { canrig_leave_(bus, 1, NULL); }

static inline int canrig_wake_(canrig *bus, uint64_t until) {
    bus->idle = until > bus->now ? 0 : bus->idle + 1;
    if (until > bus->now) bus->now = until;
    return bus->idle > 1000 ? canrig_fail(bus, "more than 1000 wake-ups at one time: its deadline does not move") : 0;
}

static inline int canrig_wait_virtual_(canrig *bus, canrig_frame *frame, uint64_t until) {
    for (;;) {
        if (bus->is_asked) {
            const uint8_t *record = bus->in + 24 + 24 * bus->record;
            if (bus->record < bus->records) {
                uint64_t time = canrig_get_(record, 8);
                if (until < time) return canrig_wake_(bus, until);
                bus->record++;
                bus->idle = 0;
                if (bus->now < time) bus->now = time;
                memset(frame, 0, sizeof *frame);
                frame->time_ns = time;
                frame->id = (uint32_t)canrig_get_(record + 8, 4);
                frame->length = record[12];
                frame->flags = record[13];
                memcpy(frame->data, record + 16, 8);
                return 1;
            }
            if (until <= bus->to || (bus->may_go_on && until <= bus->until)) return canrig_wake_(bus, until);
            uint64_t reached = bus->may_go_on ? bus->until : bus->now > bus->to ? bus->now : bus->to;
            int      error = canrig_answer_(bus, 0, until, reached, NULL);
            if (error == -EPIPE) return CANRIG_END;
            if (error < 0) return error;
        }
        int asked = canrig_ask_(bus);
        if (asked) return asked;
    }
}

static inline int canrig_wait_real_(canrig *bus, canrig_frame *frame, uint64_t until) {
    for (;;) {
        uint64_t        now = canrig_clock_();
        uint64_t        end = bus->is_stopping && bus->end < until ? bus->end : until;
        uint64_t        left = end > now ? end - now : 0;
        struct timespec timeout = {(time_t)(left / 1000000000u), (long)(left % 1000000000u)};
        struct pollfd   ready[2] = {{bus->channel, POLLIN, 0}, {bus->is_stopping ? -1 : bus->lifeline, POLLIN, 0}};
        int             count = ppoll(ready, 2, end == CANRIG_NEVER ? NULL : &timeout, NULL);
        if (count < 0 && errno != EINTR) return -errno;
        if (count <= 0 && canrig_clock_() < end) continue;
        if (count <= 0) return end == until ? 0 : CANRIG_END;
        if (ready[1].revents & POLLNVAL) bus->lifeline = -1; /* a wrapper has closed it */
        if (ready[1].revents & (POLLIN | POLLHUP | POLLERR) && read(bus->lifeline, frame->data, 8) <= 0) {
            bus->is_stopping = 1;
            bus->end = canrig_clock_() + 1000000000u;
            return CANRIG_STOP;
        }
        if (!ready[0].revents) continue;
        ssize_t length = canrig_receive_(bus, MSG_DONTWAIT);
        if (length == -EAGAIN) continue;
        if (length < 0) return (int)length;
        if (length == 0) return CANRIG_END;
        if (length != (ssize_t)sizeof(struct can_frame)) continue;
        memset(frame, 0, sizeof *frame);
        frame->time_ns = canrig_clock_();
        memcpy(&frame->id, bus->in, 4);
        frame->length = bus->in[4] > 8 ? 8 : bus->in[4];
        memcpy(frame->data, bus->in + 8, 8);
        return 1;
    }
}

/*
 * Waits for the next frame, or for a time in nanoseconds: 1 with a frame, 0 at the time, CANRIG_STOP, CANRIG_END, or -errno. A frame
 * at the very time comes first. A node that waits until a time promises to send nothing before it unless a frame arrives.
 */
static inline int canrig_wait(canrig *bus, canrig_frame *frame, uint64_t until_ns) {
    if (bus->is_over) return CANRIG_END;
    if (canrig_is_other_thread_(bus)) return -EPERM;
    return bus->kind == CANRIG_LOCKSTEP_ ? canrig_wait_virtual_(bus, frame, until_ns) : canrig_wait_real_(bus, frame, until_ns);
}

/* Queues a frame: 0, CANRIG_FULL, or -errno; -EINVAL for an identifier above 11 bits without CAN_EFF_FLAG. */
static inline int canrig_send(canrig *bus, const canrig_frame *frame) {
    if (bus->is_over) return -EPIPE;
    if (canrig_is_other_thread_(bus)) return -EPERM;
    if (frame->length > 8 || frame->flags || frame->id & CAN_ERR_FLAG || canrig_is_cut_(frame->id)) return -EINVAL;
    if (bus->kind != CANRIG_LOCKSTEP_) {
        struct can_frame out;
        memset(&out, 0, sizeof out);
        out.can_id = frame->id;
        out.can_dlc = frame->length;
        memcpy(out.data, frame->data, 8);
        if (send(bus->channel, &out, sizeof out, MSG_NOSIGNAL | MSG_DONTWAIT) >= 0) return 0;
        return errno == EAGAIN || errno == ENOBUFS ? CANRIG_FULL : -errno;
    }
    if (bus->queued == CANRIG_FRAMES_MAX) return CANRIG_FULL;
    uint8_t *record = bus->out + 24 + 24 * bus->queued++;
    memset(record, 0, 24);
    canrig_put_(record, bus->now, 8);
    canrig_put_(record + 8, frame->id, 4);
    record[12] = frame->length;
    memcpy(record + 16, frame->data, frame->length);
    if (!canrig_is_quiet_(bus, frame->id)) bus->may_go_on = 0;
    return 0;
}

#ifdef __cplusplus
}
#endif

#endif
