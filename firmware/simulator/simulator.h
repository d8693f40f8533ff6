/* The stepper board's chip in simavr: virtual time in cycles of its 16 MHz, a serial line, pins, and a log of every edge. */

#ifndef SIMULATOR_H
#define SIMULATOR_H

#include <stdint.h>

typedef struct simulator simulator;

/* An output pin has changed: 0 to 7 are D0 to D7, 8 to 13 D8 to D13, 14 to 19 A0 to A5. */
typedef struct {
    uint64_t cycle;
    uint8_t pin, level;
    uint8_t reserved[6];
} edge;

simulator *simulator_new(const char *elf, uint32_t baud);
void simulator_free(simulator *s);
void simulator_reset(simulator *s);

uint64_t simulator_cycle(simulator *s);
/* Run until a cycle, or until the chip has sent a byte if `or_byte`. Returns 0, or -1 if the chip has crashed. */
int simulator_run(simulator *s, uint64_t until, int or_byte);

/* Bytes for the chip: they follow each other on the line from now on, or behind those that are on their way. */
void simulator_send(simulator *s, const uint8_t *bytes, uint32_t count);
/* Bytes from the chip. */
uint32_t simulator_received(simulator *s, uint8_t *bytes, uint32_t most);
uint32_t simulator_on_its_way(simulator *s);

void simulator_set_pin(simulator *s, uint8_t pin, uint8_t level);
uint8_t simulator_level(simulator *s, uint8_t pin);

/* Edges since the last call. */
uint32_t simulator_edges(simulator *s, edge *edges, uint32_t most);

/* Most bytes that ever waited in the receiver, those that were lost because they found it full, and the least stack that was left. */
uint32_t simulator_worst_fill(simulator *s);
uint32_t simulator_lost(simulator *s);
uint32_t simulator_stack_left(simulator *s);

#endif
