/* The raw round trip of a seat: messages of the size of a cycle's to a Python process that sends them back. Prints microseconds. */
#include <stdio.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { ROUNDS = 50000, BYTES = 40 };
static const char echo[] = "import socket\ns = socket.socket(fileno=0)\nb = bytearray(64)\nwhile n := s.recv_into(b): s.send(b[:n])";

int main(void) {
    int  ends[2];
    char message[BYTES] = {0};
    if (socketpair(AF_UNIX, SOCK_SEQPACKET, 0, ends)) return 1;
    if (fork() == 0) {
        dup2(ends[1], 0);
        close(ends[0]);
        execlp("python3", "python3", "-c", echo, (char *)0);
        _exit(1);
    }
    close(ends[1]);
    struct timespec from, until;
    for (int round = -1000; round < ROUNDS; round++) {
        if (round == 0) clock_gettime(CLOCK_MONOTONIC, &from);
        if (send(ends[0], message, BYTES, 0) != BYTES || recv(ends[0], message, BYTES, 0) != BYTES) return 1;
    }
    clock_gettime(CLOCK_MONOTONIC, &until);
    printf("%.3f\n", (1e6 * (until.tv_sec - from.tv_sec) + 1e-3 * (until.tv_nsec - from.tv_nsec)) / ROUNDS);
}
