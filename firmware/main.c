/* Start, inputs, time, alarms, and the loop. */

#include "board.h"

#define MARGIN_MS 8             /* from the request of a ramp to the first event that it changes, with a margin */
#define SILENCE_MS 250
#define STALE (STORE / 2)       /* a store fuller than this shows that the host is alive, however short its playing time */

#ifndef BAUD
#define BAUD 1000000UL
#endif
#if F_CPU % (8 * BAUD) != 0 || BAUD < 250000
#error "BAUD is 1000000, 500000 or 250000: what the chip makes exactly, and fast enough for the stream"
#endif
#define UBRR_VALUE (F_CPU / (8 * BAUD) - 1)

struct config config;
uint8_t state, alarm;
volatile uint8_t halted;
uint16_t now_ms, started_ms;

uint8_t holds, resumes;

static uint8_t armed, armed_level;
static uint8_t seen, down;      /* buttons: pressed a millisecond ago, and debounced */
static uint16_t counted;

/* ------------------------------------------------------------------------------------------------------------------ inputs */

uint8_t inputs(void)
{
    uint8_t b = ~PINB, c = ~PINC, active = 0;
    if (b & 0x02)
        active |= 0x01;
    if (b & 0x04)
        active |= 0x02;
#if AXES == 4
    if (c & 0x10)
        active |= 0x04;
#else
    if (b & 0x10)
        active |= 0x04;
#endif
    if (c & 0x20)
        active |= INPUT_PROBE;
    if (c & 0x01)
        active |= INPUT_EMERGENCY_STOP;
    if (c & 0x02)
        active |= INPUT_HOLD;
    if (c & 0x04)
#if AXES == 4
        active |= config.drivers & LIMIT_AT_A2 ? INPUT_FOURTH : INPUT_RESUME;
#else
        active |= INPUT_RESUME;
#endif
    return active ^ config.inverted;
}

bool limits_hit(void)
{
    return inputs() & config.limits & ~armed;
}

/* The reaction to the inputs: reason + 1 of a halt, that of TOUCHED, or 0. */
#define HALT_TOUCHED 0xFF

static uint8_t wish(void)
{
    uint8_t now = inputs();
    bool moving = state == RUNNING || state == RAMPING;
    if (now & INPUT_EMERGENCY_STOP)
        return EMERGENCY_STOP + 1;
    if (moving && (now & config.limits & ~armed))
        return LIMIT + 1;
    if (moving && ((now ^ armed_level) & armed))
        return HALT_TOUCHED;
    return 0;
}

/* The inputs of either port have changed. */
#define WATCHED (1 << PCIE0 | 1 << PCIE1)

/* A level must last some microseconds, so that a spike has no effect. Called while PCICR is 0. */
static void look(void)
{
    uint8_t wanted = wish();
    for (uint8_t again = 0; wanted && again < 3; again++)
        if (wish() != wanted)
            return;
    if (wanted && !halted) {
        TIMSK1 = 0;
        halted = wanted;
    }
}

/* The other interrupts go on meanwhile: pulses have to end, and bytes come every 10 us. What has changed meanwhile, a contact that bounces,
   is in the look behind it. */
ISR(PCINT0_vect)
{
    do {
        PCICR = 0;
        sei();
        look();
        cli();
        PCIFR = 1 << PCIF0 | 1 << PCIF1;
        PCICR = WATCHED;
    } while (wish() && !halted);
}
ISR(PCINT1_vect, ISR_ALIASOF(PCINT0_vect));

static void look_now(void)
{
    PCICR = 0;
    look();
    PCICR = WATCHED;
}

/* Arm inputs: the motion ends as soon as one of them differs from its level. */
void arm(uint8_t which, uint8_t level)
{
    PCICR = 0;
    armed = which;
    armed_level = level;
    look_now();
}

/* ------------------------------------------------------------------------------------------------------------------ alarms */

void raise_alarm(uint8_t reason)
{
    flush();
    outputs_off();
    state = ALARM;
    alarm = reason;
    want_status = true;
}

static void look_for_halt(void)
{
    uint8_t why = halted;
    if (!why)
        return;
    if (why == HALT_TOUCHED) {
        flush();
        state = TOUCHED;
        want_status = true;
    } else {
        raise_alarm(why - 1);
    }
    halted = 0;
}

/* A button counts when it is pressed for one to two milliseconds, and again after a release of that length. */
static void look_at_buttons(void)
{
    uint8_t now = inputs() & (INPUT_HOLD | INPUT_RESUME), before = down;
    down = (now & seen) | (down & (now | seen));
    seen = now;
    uint8_t pressed = down & ~before;
    if (pressed & INPUT_HOLD)
        holds++;
    if (pressed & INPUT_RESUME)
        resumes++;
    if (pressed)
        want_status = true;
}

/* Called once per millisecond. */
static void tick(void)
{
    bool silent = (uint16_t)(now_ms - heard_ms) > SILENCE_MS;
    if (silent)
        heard_ms = now_ms - SILENCE_MS - 1;
    if (state == RUNNING) {
        if (silent) {
            ramp(SILENCE, config.ramp_ms);
        } else if (!(promised_ms & 0x8000)) {
            int16_t left = time_left();
            if (left < config.ramp_ms / 2 + MARGIN_MS && store_used() < STALE) {
                left = left > MARGIN_MS + 2 ? 2 * (left - MARGIN_MS) : 4;
                ramp(UNDERRUN, left < config.ramp_ms ? left : config.ramp_ms);
            }
        }
    } else if (silent && state != RAMPING && outputs_on()) {
        raise_alarm(SILENCE);
    }
    look_at_buttons();
    if (wish() && (state != ALARM || alarm != EMERGENCY_STOP))
        look_now();
}

static void watch_time(void)
{
    while ((uint16_t)(timer() - counted) >= TICKS_A_MS) {
        counted += TICKS_A_MS;
        now_ms++;
        tick();
    }
}

int main(void)
{
    /* no variable has an initial value, so that the queue starts at a page of the memory */
    config.pulse = config.rest = 10;
    config.ramp_ms = 100;
    config.limits = INPUT_LIMITS & ~INPUT_FOURTH;
    EICRA = 0x05;                       /* edges: in level mode, a simulator polls INT0 and INT1 all the time */
    PORTB = 0x01 | 0x02 | 0x04;         /* drivers off, pull-ups */
    DDRB = 0x01 | 0x08 | 0x20;
#if AXES == 4
    DDRB |= 0x10;
#else
    PORTB |= 0x10;
#endif
    PORTC = 0x27;
    DDRC = 0x08;
#if AXES == 4
    PORTC |= 0x10;
#else
    DDRC |= 0x10;
#endif
    PORTD = PORT_ALWAYS;
    DDRD = 0xFC;

    TCCR0B = 1 << CS01;
    TIMSK0 = 1 << OCIE0A;
    TCCR1B = 1 << CS11;
    TCCR2A = 0x03;                      /* fast PWM, 976 Hz */
    TCCR2B = 1 << CS22;

    UCSR0A = 1 << U2X0;                 /* before the divider: simulators compute the speed when the divider is written */
    UBRR0 = UBRR_VALUE;
    UCSR0C = 3 << UCSZ00;
    UCSR0B = UART_LISTENS;

    begin_frame();
    tail_set(0);
    head_set(0);
    parked = 1;
    width_set(WIDTH(10), WIDTH(10) + 10);
    port_set(PORT_ALWAYS, PORT_ALWAYS);
#if AXES == 4
    PCMSK0 = 0x06;
    PCMSK1 = 0x35;
#else
    PCMSK0 = 0x16;
    PCMSK1 = 0x21;
#endif
    PCICR = WATCHED;
    sei();
    for (;;) {
        receive();
        watch_time();
        look_for_halt();
        decode();
        transmit();
    }
}
