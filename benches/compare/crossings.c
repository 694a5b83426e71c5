// A lower bound for lock-step on this machine: three processes, frames of 16 bytes over SOCK_SEQPACKET, and exactly four
// blocking crossings a cycle: controller -> hub -> plant -> hub -> controller. Nothing is computed. All stay on one
// processor, as canrig's do: across processors it is three times slower.
//
//   cc -O2 -o crossings crossings.c && ./crossings [CYCLES]
//
// Prints cycles per second.
#define _GNU_SOURCE
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <signal.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

static void check(int is_good, const char *what) {
    if (!is_good) {
        perror(what);
        exit(1);
    }
}

// Sends back what comes in, as drive and controller do once a cycle.
static pid_t echo(int fd, int other) {
    pid_t pid = fork();
    check(pid >= 0, "fork");
    if (pid == 0) {
        char frame[16];
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        close(other);
        while (recv(fd, frame, sizeof frame, 0) > 0)
            check(send(fd, frame, sizeof frame, MSG_NOSIGNAL) == sizeof frame, "send");
        _exit(0);
    }
    close(fd);
    return pid;
}

static void cross(int fd, char *frame) {
    check(send(fd, frame, 16, MSG_NOSIGNAL) == 16, "send");
    check(recv(fd, frame, 16, 0) == 16, "recv");
}

int main(int argc, char **argv) {
    long cycles = argc > 1 ? atol(argv[1]) : 50000;
    int plant[2], controller[2];
    check(cycles > 0, "cycles");
    cpu_set_t here;
    CPU_ZERO(&here);
    CPU_SET(sched_getcpu(), &here);
    check(sched_setaffinity(0, sizeof here, &here) == 0, "sched_setaffinity");
    check(socketpair(AF_UNIX, SOCK_SEQPACKET, 0, plant) == 0, "socketpair");
    echo(plant[1], plant[0]);
    check(socketpair(AF_UNIX, SOCK_SEQPACKET, 0, controller) == 0, "socketpair");
    echo(controller[1], controller[0]);

    char frame[16] = {0};
    struct timespec start, end;
    clock_gettime(CLOCK_MONOTONIC, &start);
    for (long cycle = 0; cycle < cycles; cycle++) {
        cross(plant[0], frame);
        cross(controller[0], frame);
    }
    clock_gettime(CLOCK_MONOTONIC, &end);
    double seconds = (end.tv_sec - start.tv_sec) + 1e-9 * (end.tv_nsec - start.tv_nsec);
    printf("%.0f\n", cycles / seconds);
    return 0;
}
