/* The stepper board: an ATmega328P at 16 MHz (Arduino Uno or Nano) under a shield with GRBL's pins.

                      main loop                                        interrupts
   serial ──► frames ──► stream store ──► player ──► queue of events ──► Timer1: step and direction pins
              link.c      928 bytes        player.c   64 x 4 bytes       play.S

   The stream has segments (docs/explanation/segments.md) and commands between them. The player decodes them into events: a time and a
   byte for the port with all step and direction pins. The interrupt writes only prepared bytes, so edges are always within a
   microsecond of their time.

   Step pins D2 D3 D4 (and D12 for a fourth axis), direction pins D5 D6 D7 (D13), enable D8 (low: on). Limits D9 D10 D12, with four axes
   D9 D10 A4. Spindle PWM D11, its direction D13 (three axes). Flood A3, mist A4 (three axes). E-stop A0, hold A1, resume A2 (or the limit of a fourth motor), probe A5.
   Inputs have pull-ups and are active when low. The host can invert them: then an open switch, or a broken wire, is active. */

#ifndef BOARD_H
#define BOARD_H

#define VERSION 1

#ifndef AXES
#define AXES 3
#endif

#if AXES < 1 || AXES > 4
#error "AXES is 1 to 4"
#endif

/* Ticks of 0.5 us: Timer0 and Timer1 count clock/8. */
#define TICK_NS 500
#define TICKS_A_MS 2000
/* Least time between events from the host, for which the sustained rate was measured. */
#define LEAST_INTERVAL 36

/* The byte for port D that the interrupt writes: steps in bits 2-4, directions in bits 5-7. Bits 0 and 1 belong to the
   serial port, and writing them has no effect but a pull-up at bit 0. With four axes they have step and direction of the fourth axis. */
#if AXES == 4
#define PORT_AXES 0xFF
#define PORT_DIRECTIONS 0xE2
#define PORT_STEPS 0x1D
#define PORT_ALWAYS 0x00
#else
#define PORT_AXES 0xFD
#define PORT_DIRECTIONS 0xE1
#define PORT_STEPS 0x1C
#define PORT_ALWAYS 0x01
#endif

/* UCSR0B: receive with an interrupt and send; the second also with an interrupt for sending. */
#define UART_LISTENS 0x98
#define UART_TALKS 0xB8

/* Registers of the interrupts, which C code does not use (-ffixed). */
#define rSREG r2
#define rTEMP r3
#define rZ r4
#define rPORT r6
#define rIDLE r7
#define rDUE_LOW r8
#define rDUE_HIGH r9
#define rWIDTH r10
#define rTAIL r11
#define rHEAD r12
#define rGAP r13

#ifndef __ASSEMBLER__

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <stdbool.h>
#include <stdint.h>

enum { IDLE, RUNNING, RAMPING, ALARM, TOUCHED };
enum { NO_ALARM, UNDERRUN, SILENCE, EMERGENCY_STOP, LIMIT, STOPPED_BY_HOST, BAD_STREAM };

/* Inputs, one bit each, 1 if active. The fourth output has a limit switch if the host makes A2 its input. */
#if AXES == 4
#define INPUT_LIMITS 0x0F
#else
#define INPUT_LIMITS 0x07
#endif
#define INPUT_FOURTH 0x08
#define INPUT_PROBE 0x10
#define INPUT_EMERGENCY_STOP 0x20
#define INPUT_HOLD 0x40
#define INPUT_RESUME 0x80

struct config {
    uint8_t pulse;      /* least time that a step pin stays high, ticks */
    uint8_t rest;       /* least time that it stays low after that, and from a direction to the step, ticks */
    uint8_t ramp_ms;    /* duration of an emergency ramp */
    uint8_t limits;     /* limit inputs that stop the motion */
    uint8_t inverted;   /* inputs that are active when high */
    uint8_t drivers;    /* bit 0: on when their pin is high; bit 1: A2 is the limit of the fourth output, not the button */
};

/* A pulse begins at any point of a tick. */
#define WIDTH(pulse) ((pulse) + 1)

extern struct config config;
extern uint8_t state, alarm;
extern volatile uint8_t halted;         /* reason + 1 of a stop by an interrupt, 0 without one */
extern volatile uint8_t parked;         /* the interrupt has no event */
extern uint8_t queue[256];
extern uint8_t received[128];
extern volatile uint8_t received_head;
extern uint8_t sending[37];             /* the outgoing frame; the longest is a status */
extern volatile uint8_t send_at, send_length;
extern int32_t position[4];             /* after all completely decoded segments */
extern bool known_position;
extern uint8_t holds, resumes;          /* presses of the buttons */
extern uint16_t now_ms;

/* player.c */
extern uint32_t taken;                  /* bytes of the stream decoded since the start of the board */
void decode(void);
bool run(void);
void flush(void);
void ramp(uint8_t reason, uint8_t ms);
void rest_or_stop(uint8_t reason);
void raise_alarm(uint8_t reason);
void where(int32_t at[4]);
void outputs_off(void);
bool outputs_on(void);
void set_polarity(uint8_t drivers);

/* link.c */
#define STORE 928
#define LIMIT_AT_A2 0x02                /* of config.drivers */
#define ROOM_KEPT 4                     /* for the CRC after the payload, and because a full store must differ from an empty one */
extern uint8_t store[STORE];
extern uint16_t store_head, store_tail;
extern uint16_t promised_ms;            /* end time of the received stream, 15 bits; bit 15: the stream ends there */
extern uint16_t heard_ms, started_ms;
extern bool want_status;
void begin_frame(void);
void receive(void);
void transmit(void);
uint16_t store_used(void);
int16_t time_left(void);

/* The position a number of bytes, at most STORE, after a position in the store. */
static inline uint16_t behind(uint16_t at, uint16_t count)
{
    at += count;
    return at < STORE ? at : at - STORE;
}

/* main.c */
uint8_t inputs(void);
bool limits_hit(void);
void arm(uint8_t which, uint8_t level);
static inline uint16_t timer(void)
{
    cli();
    uint16_t now = TCNT1;
    sei();
    return now;
}

static inline uint8_t tail_get(void) { uint8_t v; __asm__ volatile("mov %0, r11" : "=r"(v)); return v; }
static inline uint8_t head_get(void) { uint8_t v; __asm__ volatile("mov %0, r12" : "=r"(v)); return v; }
static inline void head_set(uint8_t v) { __asm__ volatile("mov r12, %0" : : "r"(v) : "memory"); }
static inline void tail_set(uint8_t v) { __asm__ volatile("mov r11, %0" : : "r"(v) : "memory"); }
static inline void width_set(uint8_t v, uint8_t gap) { __asm__ volatile("mov r10, %0\n\tmov r13, %1" : : "r"(v), "r"(gap)); }
static inline uint16_t due_get(void) { uint16_t v; __asm__ volatile("movw %0, r8" : "=r"(v)); return v; }
static inline void due_set(uint16_t v) { __asm__ volatile("movw r8, %0" : : "r"(v)); }
static inline uint8_t port_get(void) { uint8_t v; __asm__ volatile("mov %0, r6" : "=r"(v)); return v; }
static inline void port_set(uint8_t v, uint8_t idle) { __asm__ volatile("mov r6, %0\n\tmov r7, %1" : : "r"(v), "r"(idle)); }

#endif
#endif
