/* The player: decodes segments of the stream (docs/explanation/segments.md) into events for the interrupt.

   It works at most AHEAD ahead of time, so that a ramp can begin soon. A ramp stretches the time between events by a factor that grows from
   1 along an S-curve until the motion ends. So the machine comes to rest on its path.

       position       of the segments that are done
       + segment      what was decoded of the one under way
       - waiting      events that were decoded and not played: in the queue, at the interrupt, and those that are too long to be queued yet */

#include "board.h"
#include <stddef.h>

#define LATE 100                /* ticks by which an event may be late and caught up */
#define AHEAD 6000              /* ticks */
#define SHORT 0x3FFF            /* ticks; longer times are divided into pieces */
#define PIECE 8192
#define LEAD 4000               /* ticks from RUN to time 0 of the stream, while the queue fills */
#define ROOMY 63                /* capacity of the queue, events */
#define BURST 12                /* slots between two polls of the serial port */

enum { EVEN, PLACED, PACKED, TIMED };
#define FORM 3
#define END 4
#define COMMAND 8

enum { NOTHING, OUTPUTS, ARM };
#define MOST_ARGUMENTS (LONGEST_HEAD - 2)

struct phase {
    __uint24 phase, period;
    __int24 change;
    uint8_t port;
    uint8_t steps;
};

/* slots.S has the offsets of the fields before `count`. */
struct segment {
    uint8_t left, form, always, directions, fraction, made;
    __uint24 interval;
    __int24 add;
    struct phase one, two;
    int16_t budget;             /* even: ticks that may still be planned */
    uint16_t long_ticks;        /* even: a slot too long for the queue, and its port byte */
    uint8_t long_port, is_long;
    uint16_t factor;            /* of a ramp, 1/256 */
    uint8_t count[4];           /* packed and timed: steps of each axis */
    uint8_t pair;               /* packed: the byte whose second mask is not played yet */
};
_Static_assert(offsetof(struct segment, one) == 12 && offsetof(struct segment, two) == 23 && offsetof(struct segment, budget) == 34
               && offsetof(struct segment, factor) == 40, "slots.S");

struct segment segment;
uint8_t even_slots(uint8_t most, int16_t budget, uint8_t ramping);

static struct { uint16_t ticks; uint8_t port; } waiting[3];
static uint8_t waiting_at, waiting_count;
static uint32_t wait;           /* ticks to the first of them; already stretched if it is the current one */
static bool wait_known;

static uint16_t planned;        /* due time of the last event in the queue */
static bool end_seen;
static bool starved;            /* the stream has too few bytes for the next item */
static bool behind_command;     /* the next event follows a command, before which everything was played */
static uint8_t spindle;

volatile uint8_t parked;
uint32_t taken;
int32_t position[4];
bool known_position;

static const uint8_t axis_step[4] PROGMEM = { 0x04, 0x08, 0x10, 0x01 };
static const uint8_t axis_direction[4] PROGMEM = { 0x20, 0x40, 0x80, 0x02 };

/* ------------------------------------------------------------------------------------------------------------------- ramp */

/* Stretch factors in 1/256 at 1/64, 3/64 .. of a ramp: 1 / (1 - x^2 (3 - 2 x)). After the last one nothing moves. */
static const uint16_t stretched[30] PROGMEM = {
    256, 258, 261, 265, 271, 278, 287, 297, 310, 325, 342, 363, 387, 415, 449,
    489, 537, 595, 667, 756, 869, 1014, 1207, 1470, 1841, 2392, 3262, 4762, 7694, 14749,
};
#define RAMP_PIECES 32
#define RAMP_STEPS 30

static uint8_t ramp_step, ramp_reason;
static uint16_t ramp_piece;
static int16_t ramp_left;       /* ticks to the next step */

void ramp(uint8_t reason, uint8_t ms)
{
    if (state != RUNNING)
        return;
    state = RAMPING;
    ramp_reason = reason;
    ramp_step = 0;
    ramp_piece = ramp_left = (uint16_t)ms * (TICKS_A_MS / RAMP_PIECES);
    segment.factor = 256;
}

/* Come to rest on the path if there is motion. An alarm follows in any case, but does not replace another one. */
void rest_or_stop(uint8_t reason)
{
    if (state == RUNNING)
        ramp(reason, config.ramp_ms);
    else if (state != RAMPING && state != ALARM)
        raise_alarm(reason);
}

/* Advance the ramp by the ticks planned. */
static void go_down(uint16_t ticks)
{
    while (ticks && ramp_step < RAMP_STEPS) {
        if ((int16_t)ticks < ramp_left) {
            ramp_left -= ticks;
            return;
        }
        ticks -= ramp_left;
        ramp_left = ramp_piece;
        ramp_step++;
        segment.factor = pgm_read_word(&stretched[ramp_step < RAMP_STEPS ? ramp_step : RAMP_STEPS - 1]);
    }
}

/* Stretch a time; an event after the end of the ramp ends the ramp. */
static uint32_t stretch(uint16_t ticks)
{
    uint32_t longer = (uint32_t)ticks * segment.factor >> 8;
    if (longer > (uint32_t)(RAMP_STEPS - ramp_step) * ramp_piece)
        ramp_step = RAMP_STEPS;
    return longer;
}

/* ------------------------------------------------------------------------------------------------------------------ queue */

static inline uint8_t room(void)
{
    return (uint8_t)(tail_get() - head_get() - 4) >> 2;
}

/* Give the idle interrupt the first event of the queue. */
static void unpark(void)
{
    uint8_t *event = queue + tail_get();
    uint16_t due = due_get() + (event[0] | (uint16_t)event[1] << 8);
    while (PORTD & PORT_STEPS)
        ;                       /* Timer0 will soon end the pulse of the event before */
    cli();
    if (!halted) {
        due_set(due);
        port_set(event[2], event[3]);
        tail_set(tail_get() + 4);
        PORTD = event[3];
#if AXES == 4
        if (event[3] & 2)
            PORTB |= 0x20;
        else
            PORTB &= ~0x20;
#endif
        uint16_t least = TCNT1 + config.rest + 2;
        int16_t late = least - due;
        if (late > 0)
            due = least;
        if (late > LATE && !behind_command) {
            /* catching up would be a burst of steps: come to rest from here */
            due_set(least);
            planned += late;
            ramp(UNDERRUN, config.ramp_ms);
        }
        behind_command = false;
        OCR1A = due;
        TIFR1 = 1 << OCF1A;
        parked = 0;
        TIMSK1 = 1 << OCIE1A;
    }
    sei();
}

static inline void put(uint16_t ticks, uint8_t port)
{
    uint8_t head = head_get();
    uint8_t *event = queue + head;
    event[0] = ticks;
    event[1] = ticks >> 8;
    event[2] = port;
    event[3] = segment.directions;
    head_set(head + 4);
    planned += ticks;
}

static inline bool early(uint16_t now)
{
    return (int16_t)(planned - now) < AHEAD;
}

/* Plan waiting events: long ones, those under a ramp, or several in a slot. */
static void put_waiting(void)
{
    uint16_t now = timer();
    while (waiting_count && room() && early(now)) {
        if (!wait_known) {
            uint16_t ticks = waiting[waiting_at].ticks;
            wait = ticks;
            if (state == RAMPING) {
                wait = stretch(ticks);
                if (ramp_step == RAMP_STEPS)
                    return;
            }
            wait_known = true;
        }
        if (wait > SHORT) {
            put(PIECE, segment.directions);
            wait -= PIECE;
            if (state == RAMPING)
                go_down(PIECE);
        } else {
            put(wait, waiting[waiting_at].port);
            if (state == RAMPING)
                go_down(wait);
            waiting_at++;
            waiting_count--;
            wait_known = false;
        }
    }
    if (parked && room() != ROOMY)
        unpark();
}

static void wait_for(uint16_t ticks, uint8_t port)
{
    uint8_t k = waiting_count++;
    waiting[k].ticks = ticks;
    waiting[k].port = port;
    waiting_at = 0;
}

/* Plan an event, one of up to three at a time; short ones go to the queue directly. */
static void event(uint16_t ticks, uint8_t port)
{
    if (ticks > SHORT || waiting_count || state != RUNNING)
        wait_for(ticks, port);
    else
        put(ticks, port);
}

/* ------------------------------------------------------------------------------------------------------------------ slots */

static void even(uint8_t most)
{
    uint16_t limit = timer() + AHEAD, before = planned;
    uint8_t made = even_slots(most, limit - planned, state == RAMPING);
    planned = limit - segment.budget;
    if (state == RAMPING)
        go_down(planned - before);
    segment.left -= made;
    segment.made += made;
    if (segment.is_long)
        wait_for(segment.long_ticks, segment.long_port);
}

static uint8_t due(struct phase *axis)
{
    uint8_t port = 0;
    if ((uint8_t)(axis->phase >> 16) == 0) {
        port = axis->port;
        axis->phase += axis->period;
        axis->period += axis->change;
        axis->steps++;
    }
    axis->phase -= 0x10000;
    return port;
}

/* Position of a step in a slot, ticks. */
static inline uint16_t place(uint16_t phase, uint16_t ticks)
{
    return ((uint32_t)phase * ticks + 0x8000) >> 16;
}

static void placed_slot(void)
{
    __uint24 sum = segment.interval + segment.fraction;
    uint16_t ticks = sum >> 8;
    segment.fraction = sum;
    segment.interval += segment.add;
    uint16_t here = 0, there = 0;
    if ((uint8_t)(segment.one.phase >> 16) == 0)
        here = place(segment.one.phase, ticks);
    if ((uint8_t)(segment.two.phase >> 16) == 0)
        there = place(segment.two.phase, ticks);
    uint8_t one = due(&segment.one), two = due(&segment.two), last = segment.always;
    /* at least two ticks before the end, or at the end */
    if (one && ticks - here < 2)
        last |= one, one = 0;
    if (two && ticks - there < 2)
        last |= two, two = 0;
    if (one && two) {
        if (there < here) {
            uint16_t later = here;
            here = there, there = later;
            uint8_t port = one;
            one = two, two = port;
        }
        if (there - here < 2)
            one |= two, two = 0;
    } else if (two) {
        here = there, one = two, two = 0;
    }
    if (one) {
        event(here, segment.directions | one);
        ticks -= here;
    }
    if (two) {
        there -= here;
        event(there, segment.directions | two);
        ticks -= there;
    }
    event(ticks, last);
    segment.left--;
    segment.made++;
}

static void placed_slots(void)
{
    uint16_t now = timer();
    uint8_t free = room();
    if (free > BURST)
        free = BURST;
    for (; free >= 3 && segment.left && !waiting_count && early(now); free -= 3)
        placed_slot();
}

/* Convert a mask of axes to the step bits of the port. */
static inline uint8_t steps_of(uint8_t mask)
{
#if AXES == 4
    return (uint8_t)(mask << 2 & 0x1C) | mask >> 3;
#else
    return mask << 2 & 0x1C;
#endif
}

#define COUNT(axis, bit) \
    if (mask & bit) \
        segment.count[axis]++

/* Packed and timed segments: each slot has its own data in the stream. */
static void listed_slots(uint8_t most)
{
    const bool timed = segment.form == TIMED, plain = state == RUNNING;
    const uint8_t directions = segment.directions;
    const uint8_t *at = store + store_tail;
    uint16_t there = store_used(), before = there;
    int16_t room_ahead = AHEAD - (int16_t)(planned - timer()), budget = room_ahead;
    uint8_t made = 0, head = head_get();
    while (made < most && budget > 0) {
        uint8_t mask;
        uint16_t ticks;
        if (timed) {
            starved = there < 2;
            if (starved)
                break;
            there -= 2;
            ticks = *at;
            if (++at == store + STORE)
                at = store;
            mask = *at;
            if (++at == store + STORE)
                at = store;
            ticks |= (uint16_t)(mask & 15) << 8;
            mask >>= 4;
        } else {
            if ((segment.made + made) & 1) {
                mask = segment.pair >> 4;
            } else {
                starved = there == 0;
                if (starved)
                    break;
                there--;
                mask = segment.pair = *at;
                if (++at == store + STORE)
                    at = store;
            }
            mask &= 15;
            __uint24 sum = segment.interval + segment.fraction;
            ticks = sum >> 8;
            segment.fraction = sum;
            segment.interval += segment.add;
        }
        COUNT(0, 1);
        COUNT(1, 2);
        COUNT(2, 4);
#if AXES == 4
        COUNT(3, 8);
#endif
        made++;
        uint8_t port = directions | steps_of(mask);
        if (ticks > SHORT || !plain) {
            wait_for(ticks, port);
            break;
        }
        uint8_t *event = queue + head;
        event[0] = ticks;
        event[1] = ticks >> 8;
        event[2] = port;
        event[3] = directions;
        head += 4;
        head_set(head);
        budget -= ticks;
    }
    planned += room_ahead - budget;
    store_tail = at - store;
    taken += before - there;
    segment.left -= made;
    segment.made += made;
}

/* --------------------------------------------------------------------------------------------------------------- position */

static uint8_t made_by(uint8_t axis)
{
    uint8_t bit = pgm_read_byte(&axis_step[axis]);
    if (segment.form >= PACKED)
        return segment.count[axis];
    if (segment.always & bit)
        return segment.made;
    return segment.one.port & bit ? segment.one.steps : segment.two.port & bit ? segment.two.steps : 0;
}

static void forget_steps(void)
{
    segment.made = segment.one.steps = segment.two.steps = 0;
    for (uint8_t axis = 0; axis < 4; axis++)
        segment.count[axis] = 0;
}

/* Add the steps of a completely decoded segment to the position. */
static void settle(void)
{
    for (uint8_t axis = 0; axis < AXES; axis++) {
        uint8_t steps = made_by(axis);
        if (steps == 0)
            continue;
        if (segment.directions & pgm_read_byte(&axis_direction[axis]))
            position[axis] -= steps;
        else
            position[axis] += steps;
    }
    forget_steps();
}

#define BACK(axis, step, direction) \
    if (port & step) \
        back[axis] += port & direction ? 1 : -1

static inline void take_back(int8_t back[4], uint8_t port)
{
    BACK(0, 0x04, 0x20);
    BACK(1, 0x08, 0x40);
    BACK(2, 0x10, 0x80);
#if AXES == 4
    BACK(3, 0x01, 0x02);
#endif
}

/* Position according to the steps made at the pins. */
void where(int32_t at[4])
{
    int8_t back[4] = { 0, 0, 0, 0 };
    cli();
    uint8_t tail = tail_get(), port = parked ? 0 : port_get();
    sei();
    take_back(back, port);
    for (uint8_t head = head_get(); tail != head; tail += 4)
        take_back(back, queue[(uint8_t)(tail + 2)]);
    for (uint8_t k = 0; k < waiting_count; k++)
        take_back(back, waiting[waiting_at + k].port);
    for (uint8_t axis = 0; axis < 4; axis++) {
        uint8_t steps = axis < AXES ? made_by(axis) : 0;
        at[axis] = position[axis] + back[axis];
        at[axis] += segment.directions & pgm_read_byte(&axis_direction[axis]) ? -(int32_t)steps : steps;
    }
}

/* ---------------------------------------------------------------------------------------------------------------- outputs */

#define ENABLED 0x01
#define SPINDLE 0x02
#define BACKWARD 0x04
#define FLOOD 0x08
#define MIST 0x10

static void set_outputs(uint8_t bits, uint8_t duty)
{
    /* single bits, with one instruction each: an interrupt may write the others in between */
    if ((bits ^ config.drivers) & ENABLED)
        PORTB &= ~0x01;
    else
        PORTB |= 0x01;
    OCR2A = duty;
    /* a duty of 0 would still give one pulse per period */
    TCCR2A = bits & SPINDLE && duty ? 0x83 : 0x03;
    spindle = bits & (SPINDLE | FLOOD | MIST);
    uint8_t port = PORTC & ~0x18;
    if (bits & FLOOD)
        port |= 0x08;
#if AXES < 4
    if (bits & BACKWARD)
        PORTB |= 0x20;
    else
        PORTB &= ~0x20;
    if (bits & MIST)
        port |= 0x10;
#else
    port |= 0x10;               /* the pull-up of Z's limit */
#endif
    PORTC = port;
}

/* Spindle and coolant; the drivers go on holding. */
void outputs_off(void)
{
    set_outputs((PORTB ^ config.drivers) & 0x01 ? 0 : ENABLED, 0);
}

/* Which level switches the drivers on; off or on they stay. */
void set_polarity(uint8_t drivers)
{
    if ((drivers ^ config.drivers) & 0x01)
        PINB = 0x01;            /* turns the pin over */
    config.drivers = drivers;
}

bool outputs_on(void)
{
    return spindle != 0;
}

/* ----------------------------------------------------------------------------------------------------------------- stream */

#define LONGEST_HEAD 24

/* Some of the first bytes of what comes next; they are taken by skip(). */
static void look_at(uint8_t *head, uint8_t from, uint8_t until)
{
    const uint8_t *at = store + behind(store_tail, from);
    for (; from < until; from++) {
        head[from] = *at;
        if (++at == store + STORE)
            at = store;
    }
}

static void skip(uint8_t count)
{
    store_tail = behind(store_tail, count);
    taken += count;
}

static void begin_phase(struct phase *axis, uint8_t mask, const uint8_t *from)
{
    axis->phase = 0xFFFFFF;
    axis->port = 0;
    if (mask) {
        axis->port = steps_of(mask);
        axis->phase = *(const __uint24 *)from;
        axis->period = *(const __uint24 *)(from + 3);
        axis->change = *(const int16_t *)(from + 6);
    }
}

static void command(uint8_t code, const uint8_t *given)
{
    if (code == OUTPUTS)
        set_outputs(given[0], given[1]);
    else if (code == ARM) {
        arm(given[0], given[1]);
    }
}

/* The next segment or command, if it is there. */
static void next_item(void)
{
    uint16_t there = store_used();
    starved = there < 2;
    if (starved)
        return;
    uint8_t head[LONGEST_HEAD];
    look_at(head, 0, 2);
    uint8_t slots = head[0], what = head[1], form = what & FORM, roles = 0, count = 0;
    if (what & COMMAND) {
        starved = there < 2 + (uint16_t)slots;
        if (slots > MOST_ARGUMENTS) {
            raise_alarm(BAD_STREAM);
        } else if (!starved && parked) {
            /* all before it has been played */
            look_at(head, 2, 2 + slots);
            skip(2 + slots);
            behind_command = true;
            command(what >> 4, head + 2);
            end_seen = what & END;
        }
        return;
    }
    uint8_t size = form == TIMED ? 2 : form == PACKED ? 7 : 8;
    starved = there < size;
    if (starved)
        return;
    look_at(head, 2, size);
    if (form < PACKED) {
        roles = head[7];
        for (uint8_t phases = roles >> 4; phases; phases &= phases - 1)
            count++;
        size += count << 3;
        starved = there < size;
    }
    if (slots == 0 || count > 2 || (count && !(roles & 15)) || (roles >> 4 & roles)) {
        raise_alarm(BAD_STREAM);
        return;
    }
    if (starved)
        return;
    if (count)
        look_at(head, 8, size);
    skip(size);
    settle();
    uint8_t down = what >> 4;
    segment.form = form;
    segment.directions = (uint8_t)(down << 5) | PORT_ALWAYS;
#if AXES == 4
    if (down & 8)
        segment.directions |= 2;
#endif
    segment.always = segment.directions;
    segment.one.port = segment.two.port = 0;
    if (form != TIMED) {
        segment.interval = *(const __uint24 *)(head + 2);
        segment.add = *(const int16_t *)(head + 5);
        if (form != PACKED) {
            uint8_t phases = roles >> 4, first = phases & -phases;
            segment.always |= steps_of(roles & 15);
            begin_phase(&segment.one, first, head + 8);
            begin_phase(&segment.two, phases & ~first, head + 16);
        }
    }
    segment.left = slots;
    end_seen = what & END;
}

/* Nothing is under way, and nothing will be until the host says so: where the machine is now is where it stays. */
void flush(void)
{
    int32_t at[4];
    cli();
    TIMSK1 = 0;
    sei();
    where(at);
    for (uint8_t axis = 0; axis < 4; axis++)
        position[axis] = at[axis];
    segment.left = segment.always = 0;
    segment.one.port = segment.two.port = 0;
    segment.form = EVEN;
    forget_steps();
    waiting_count = 0;
    wait_known = end_seen = starved = false;
    head_set(tail_get());
    parked = 1;
    arm(0, 0);
    store_tail = store_head;
}

/* Begin to play what has come. Not after a reset, before a host has said where the machine stands: what has come may be the rest of
   something that began before. */
bool run(void)
{
    if (state != IDLE || store_used() == 0 || !known_position)
        return false;
    segment.fraction = 0;
    starved = end_seen = behind_command = false;
    planned = timer() + LEAD;
    due_set(planned);
    started_ms = now_ms;
    state = RUNNING;
    if (limits_hit())
        raise_alarm(LIMIT);
    return true;
}

static void decode_some(void)
{
    if (waiting_count) {
        put_waiting();
        return;
    }
    if (segment.left == 0)
        next_item();
    uint8_t most = room();
    if (most > BURST)
        most = BURST;
    if (most > segment.left)
        most = segment.left;
    if (most && early(timer())) {
        if (segment.form == EVEN)
            even(most);
        else if (segment.form == PLACED)
            placed_slots();
        else
            listed_slots(most);
        if (parked && room() != ROOMY)
            unpark();
    }
}

void decode(void)
{
    for (uint8_t k = 0; k < 4 && (state == RUNNING || state == RAMPING); k++) {
        if (state == RAMPING && ramp_step == RAMP_STEPS) {
            if (parked)
                raise_alarm(ramp_reason);
            return;
        }
        decode_some();
        if (starved)
            break;
        if (segment.left && state == RUNNING)
            return;
    }
    if (starved && parked && !waiting_count && (state == RUNNING || state == RAMPING)) {
        if (segment.left == 0 && store_used() == 0 && end_seen && state == RUNNING) {
            settle();
            state = IDLE;
        } else {
            raise_alarm(state == RAMPING ? ramp_reason : UNDERRUN);
        }
    }
}
