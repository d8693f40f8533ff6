/* The stepper board's chip in simavr. What simavr does otherwise than the chip, and what is done about it:

   - A byte takes 11 bit times instead of 10, and counts as received that much later than it was handed over. It is handed over at the end
     of its last bit, 10 bit times after the one before, and the delay is taken out for that moment. What the chip sends takes 10, too.
   - Its receiver has room for 64 bytes. Here it has the chip's 2 and the one that comes in; what does not fit is lost, and counted.
   - To enter an interrupt takes no time, on the chip 4 cycles.
   - Inputs without a source read 0: all get the level of a pull-up. */

#include "simulator.h"

#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

DEFINE_FIFO(uint16_t, uart_fifo);

#define FREQUENCY 16000000
#define BITS_A_BYTE 10
#define PINS 20
#define RECEIVER 3
#define LOOK_AGAIN 8            /* cycles */
#define AT_ONCE 8               /* cycles that simavr runs without a look at what else is to be done; less where a timer is due */
#define PAINT 0xA5

typedef struct {
    uint8_t *bytes;
    uint32_t first, count, room;
} line;

typedef struct {
    simulator *owner;
    uint8_t number;
} pin;

struct simulator {
    avr_t *avr;
    avr_irq_t *uart_input;
    avr_uart_t *uart;
    uint64_t byte_cycles, free_at;
    line to_chip, from_chip;
    edge *edges;
    uint32_t edge_count, edge_room;
    uint8_t arrived[RECEIVER];
    uint32_t arrived_count, worst_fill, lost;
    uint32_t bss_end;
    pin pins[PINS];
    uint8_t levels[PINS];
};

static const char ports[PINS + 1] = "DDDDDDDDBBBBBBCCCCCC";
static const uint8_t bits[PINS] = { 0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 0, 1, 2, 3, 4, 5 };

static void append(line *to, const uint8_t *bytes, uint32_t count)
{
    if (to->first) {
        memmove(to->bytes, to->bytes + to->first, to->count);
        to->first = 0;
    }
    if (to->count + count > to->room) {
        to->room = 2 * (to->count + count) + 256;
        to->bytes = realloc(to->bytes, to->room);
    }
    memcpy(to->bytes + to->count, bytes, count);
    to->count += count;
}

static void byte_from_chip(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    uint8_t byte = value;
    append(&((simulator *)param)->from_chip, &byte, 1);
}

static void pin_changed(avr_irq_t *irq, uint32_t value, void *param)
{
    const pin *which = param;
    simulator *s = which->owner;
    (void)irq;
    if (s->edge_count == s->edge_room) {
        s->edge_room = 2 * s->edge_room + 4096;
        s->edges = realloc(s->edges, s->edge_room * sizeof *s->edges);
    }
    s->edges[s->edge_count++] = (edge){ .cycle = s->avr->cycle, .pin = which->number, .level = value != 0 };
}

/* Of the bytes that have arrived simavr holds one: it would give out a second one as late as if it were still on the line. */
static avr_cycle_count_t hand_over(avr_t *avr, avr_cycle_count_t when, void *param)
{
    simulator *s = param;
    (void)avr;
    if (uart_fifo_isempty(&s->uart->input)) {
        avr_cycle_count_t delay = s->uart->cycles_per_byte;
        s->uart->cycles_per_byte = 1;
        avr_raise_irq(s->uart_input, s->arrived[0]);
        s->uart->cycles_per_byte = delay;
        memmove(s->arrived, s->arrived + 1, --s->arrived_count);
    }
    return s->arrived_count ? when + LOOK_AGAIN : 0;
}

/* A byte's last bit has come over the line. What finds the receiver full is lost, as on the chip. */
static avr_cycle_count_t byte_to_chip(avr_t *avr, avr_cycle_count_t when, void *param)
{
    simulator *s = param;
    line *from = &s->to_chip;
    if (from->count == 0)
        return 0;
    uint8_t byte = from->bytes[from->first++];
    from->count--;
    s->free_at = when + s->byte_cycles;
    uint32_t fill = uart_fifo_get_read_size(&s->uart->input) + s->arrived_count;
    if (fill < RECEIVER) {
        s->arrived[s->arrived_count++] = byte;
        fill++;
        if (s->arrived_count == 1)
            avr_cycle_timer_register(avr, 1, hand_over, s);
    } else {
        s->lost++;
    }
    if (fill > s->worst_fill)
        s->worst_fill = fill;
    return from->count ? s->free_at : 0;
}

simulator *simulator_new(const char *elf, uint32_t baud)
{
    elf_firmware_t firmware;
    memset(&firmware, 0, sizeof firmware);
    if (elf_read_firmware(elf, &firmware) != 0)
        return NULL;
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    if (avr == NULL)
        return NULL;
    simulator *s = calloc(1, sizeof *s);
    s->avr = avr;
    avr_init(avr);
    avr->frequency = FREQUENCY;
    avr->log = LOG_ERROR;
    avr_load_firmware(avr, &firmware);
    avr->frequency = FREQUENCY;
    s->bss_end = 0x100 + firmware.datasize + firmware.bsssize;
    s->byte_cycles = (uint64_t)FREQUENCY * BITS_A_BYTE / baud;
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    s->uart_input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    for (avr_io_t *port = avr->io_port; port; port = port->next)
        if (port->kind && strcmp(port->kind, "uart") == 0)
            s->uart = (avr_uart_t *)port;
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), byte_from_chip, s);
    for (uint8_t k = 0; k < PINS; k++) {
        s->pins[k] = (pin){ s, k };
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(ports[k]), bits[k]), pin_changed, &s->pins[k]);
    }
    memset(s->levels, 1, sizeof s->levels);
    simulator_reset(s);
    return s;
}

void simulator_free(simulator *s)
{
    avr_terminate(s->avr);
    free(s->to_chip.bytes);
    free(s->from_chip.bytes);
    free(s->edges);
    free(s);
}

void simulator_reset(simulator *s)
{
    avr_cycle_count_t now = s->avr->cycle;
    avr_reset(s->avr);
    s->avr->run_cycle_limit = AT_ONCE;
    s->avr->cycle = now;
    s->to_chip.count = s->from_chip.count = s->arrived_count = 0;
    memset(s->avr->data + s->bss_end, PAINT, s->avr->ramend + 1 - s->bss_end);
    uint32_t edges = s->edge_count;
    for (uint8_t k = 0; k < PINS; k++) {
        if (ports[k] != 'D') {
            /* a level that is what it was before the reset would not be noticed */
            uint8_t level = s->levels[k];
            simulator_set_pin(s, k, !level);
            simulator_set_pin(s, k, level);
        }
    }
    s->edge_count = edges;      /* these are none of the chip's */
}

uint64_t simulator_cycle(simulator *s)
{
    return s->avr->cycle;
}

int simulator_run(simulator *s, uint64_t until, int or_byte)
{
    s->uart->cycles_per_byte = s->byte_cycles;
    while (s->avr->cycle < until && !(or_byte && s->from_chip.count)) {
        int state = avr_run(s->avr);
        if (state == cpu_Done || state == cpu_Crashed)
            return -1;
    }
    return 0;
}

void simulator_send(simulator *s, const uint8_t *bytes, uint32_t count)
{
    uint64_t now = s->avr->cycle;
    bool waiting = s->to_chip.count > 0;
    append(&s->to_chip, bytes, count);
    if (!waiting && count)
        avr_cycle_timer_register(s->avr, s->free_at > now ? s->free_at - now : 1, byte_to_chip, s);
}

uint32_t simulator_received(simulator *s, uint8_t *bytes, uint32_t most)
{
    line *from = &s->from_chip;
    uint32_t count = from->count < most ? from->count : most;
    memcpy(bytes, from->bytes + from->first, count);
    from->first += count;
    from->count -= count;
    return count;
}

uint32_t simulator_on_its_way(simulator *s)
{
    return s->to_chip.count;
}

void simulator_set_pin(simulator *s, uint8_t pin, uint8_t level)
{
    /* simavr would take the chip's pull-up for the level as soon as that is switched on */
    avr_ioport_external_t outside = { .name = ports[pin] };
    s->levels[pin] = level;
    for (uint8_t k = 0; k < PINS; k++)
        if (ports[k] == ports[pin]) {
            outside.mask |= 1 << bits[k];
            outside.value |= (s->levels[k] ? 1 : 0) << bits[k];
        }
    avr_ioctl(s->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(ports[pin]), &outside);
    avr_raise_irq(avr_io_getirq(s->avr, AVR_IOCTL_IOPORT_GETIRQ(ports[pin]), bits[pin]), level);
}

uint8_t simulator_level(simulator *s, uint8_t pin)
{
    return avr_io_getirq(s->avr, AVR_IOCTL_IOPORT_GETIRQ(ports[pin]), bits[pin])->value & 1;
}

uint32_t simulator_edges(simulator *s, edge *edges, uint32_t most)
{
    uint32_t count = s->edge_count < most ? s->edge_count : most;
    memcpy(edges, s->edges, count * sizeof *edges);
    memmove(s->edges, s->edges + count, (s->edge_count - count) * sizeof *edges);
    s->edge_count -= count;
    return count;
}

uint32_t simulator_worst_fill(simulator *s)
{
    return s->worst_fill;
}

uint32_t simulator_lost(simulator *s)
{
    return s->lost;
}

uint32_t simulator_stack_left(simulator *s)
{
    uint32_t at = s->bss_end;
    while (at <= s->avr->ramend && s->avr->data[at] == PAINT)
        at++;
    return at - s->bss_end;
}
