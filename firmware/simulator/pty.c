/* The stepper board on a pseudo-terminal, in real time: simulator FIRMWARE.elf [EDGES.csv [BAUD]]

   Prints the terminal's name, for --port, and runs until it is interrupted. Then every edge of the output pins is in EDGES.csv: cycle of
   the 16 MHz clock, pin (0 to 13: D0 to D13, 14 to 19: A0 to A5), level. SIGUSR1 presses the e-stop, SIGUSR2 lets it go. */

#define _GNU_SOURCE
#include "simulator.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define CYCLES_A_SECOND 16000000ULL
#define SLICE 8000              /* cycles, half a millisecond: so often the terminal is looked at */
#define LATE 800000             /* cycles: a computer that is later than this is not caught up with */
#define EMERGENCY_STOP_PIN 14

static volatile sig_atomic_t over, emergency_stop = -1;

static void on_signal(int number)
{
    if (number == SIGUSR1)
        emergency_stop = 0;
    else if (number == SIGUSR2)
        emergency_stop = 1;
    else
        over = 1;
}

static uint64_t clock_cycles(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * CYCLES_A_SECOND + (uint64_t)now.tv_nsec * (CYCLES_A_SECOND / 1000000) / 1000;
}

int main(int count, char **arguments)
{
    if (count < 2) {
        fprintf(stderr, "usage: simulator FIRMWARE.elf [EDGES.csv [BAUD]]\n");
        return 2;
    }
    simulator *s = simulator_new(arguments[1], count > 3 ? strtoul(arguments[3], NULL, 10) : 1000000);
    if (s == NULL) {
        fprintf(stderr, "%s is no firmware\n", arguments[1]);
        return 2;
    }
    FILE *log = count > 2 ? fopen(arguments[2], "w") : NULL;
    if (count > 2 && log == NULL) {
        perror(arguments[2]);
        return 2;
    }
    int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master < 0 || grantpt(master) < 0 || unlockpt(master) < 0) {
        perror("pseudo-terminal");
        return 2;
    }
    /* The other end stays open, so that nothing breaks when a program closes it; raw, for the line editor would answer. */
    int slave = open(ptsname(master), O_RDWR | O_NOCTTY);
    struct termios raw;
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    fcntl(master, F_SETFL, O_NONBLOCK);
    signal(SIGINT, on_signal);
    signal(SIGTERM, on_signal);
    signal(SIGUSR1, on_signal);
    signal(SIGUSR2, on_signal);
    printf("%s\n", ptsname(master));
    fflush(stdout);

    uint64_t began = clock_cycles() - simulator_cycle(s);
    uint8_t bytes[256];
    edge edges[256];
    int crashed = 0;
    while (!over && !crashed) {
        uint64_t real = clock_cycles() - began, now = simulator_cycle(s);
        if (real < now + SLICE) {
            struct pollfd waiting = { .fd = master, .events = POLLIN };
            struct timespec pause = { 0, (long)((now + SLICE - real) * 1000 / 16) };
            ppoll(&waiting, 1, &pause, NULL);
        } else if (real > now + LATE) {
            began += real - now - SLICE;
        }
        if (emergency_stop >= 0) {
            simulator_set_pin(s, EMERGENCY_STOP_PIN, emergency_stop);
            emergency_stop = -1;
        }
        ssize_t got = read(master, bytes, sizeof bytes);
        if (got > 0)
            simulator_send(s, bytes, got);
        real = clock_cycles() - began;
        crashed = real > now && simulator_run(s, real < now + SLICE ? real : now + SLICE, 0) != 0;
        uint32_t sent = simulator_received(s, bytes, sizeof bytes);
        if (sent && write(master, bytes, sent) < 0 && errno != EAGAIN)
            over = 1;
        for (uint32_t k; (k = simulator_edges(s, edges, 256)) > 0;)
            for (uint32_t i = 0; log && i < k; i++)
                fprintf(log, "%llu,%u,%u\n", (unsigned long long)edges[i].cycle, edges[i].pin, edges[i].level);
    }
    if (log)
        fclose(log);
    if (crashed)
        fprintf(stderr, "the firmware has crashed\n");
    return crashed;
}
