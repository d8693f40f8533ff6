/* The serial link: frames in and out, in the format of PROTOCOL.md.

   A frame is decoded byte by byte on arrival. Stream bytes are written to the store at once, after the committed bytes. They are committed
   when the frame is complete, in order and without errors. */

#include "board.h"
#include <util/crc16.h>

enum { DATA = 0x01, HELLO, ASK, CONFIGURE, SET_POSITION, RUN, STOP, CLEAR };
enum { ACK = 0x81, NAK, STATUS, WELCOME };

#define DATA_HEAD 4             /* type, sequence, promise */
#define LONGEST_CONTROL 18      /* decoded: type, token, four positions */

uint8_t store[STORE];
uint16_t store_head, store_tail;
uint16_t promised_ms, heard_ms;

uint8_t received[128];
volatile uint8_t received_head;
static uint8_t received_tail;
static uint8_t frame[LONGEST_CONTROL + 2];
static uint8_t length;                  /* of the incoming frame: bytes so far, */
static uint16_t crc, spare;             /* their CRC, position of its next stream byte */
static uint8_t block, block_left;       /* COBS */
static bool broken;
static uint8_t expected, token;
static bool naked;
static bool want_ack, want_nak, want_welcome;
bool want_status;
static uint16_t told_room;

uint8_t sending[37];
volatile uint8_t send_at, send_length;

uint16_t store_used(void)
{
    uint16_t used = store_head - store_tail;
    return store_head < store_tail ? used + STORE : used;
}

static uint16_t store_room(void)
{
    return STORE - ROOM_KEPT - store_used();
}

/* ms of the stream that are not played yet. */
int16_t time_left(void)
{
    return (int16_t)((uint16_t)(promised_ms - (state == RUNNING ? now_ms - started_ms : 0)) << 1) >> 1;
}

void begin_frame(void)
{
    length = 0;
    crc = 0xFFFF;
    block = 0xFF;
    block_left = 0;
    broken = false;
    spare = store_head;
}

static uint16_t word(uint8_t at)
{
    return frame[at] | (uint16_t)frame[at + 1] << 8;
}

static void data_came(void)
{
    uint8_t ahead = frame[1] - expected;
    if (ahead == 0) {
        expected++;
        naked = false;
        want_ack = true;
        if (state == IDLE || state == RUNNING) {
            store_head = behind(store_head, length - DATA_HEAD - 2);
            promised_ms = word(2);
        }
    } else if (ahead >= 128) {
        want_ack = true;
    } else if (!naked) {
        naked = want_nak = true;
    }
}

/* Invalid values are refused: pulse and rest share a byte, and an 8-bit timer ends the pulse. */
#define LONGEST_PULSE 120

static bool configure(const uint8_t *payload)
{
    uint8_t pulse = payload[0], rest = payload[1] > pulse ? payload[1] : pulse;
    if (pulse == 0 || rest > LONGEST_PULSE || payload[2] == 0)
        return false;
    config.pulse = pulse;
    config.rest = rest;
    config.ramp_ms = payload[2];
    config.limits = payload[3] & INPUT_LIMITS;
    config.inverted = payload[4] & ~(0x0F & ~INPUT_LIMITS);
    set_polarity(payload[5]);
    width_set(WIDTH(pulse), WIDTH(pulse) + rest);
    return true;
}

static void control_came(void)
{
    uint8_t size = length - 4;
    const uint8_t *payload = frame + 2;
    bool again = frame[1] == token;
    bool still = state != RUNNING && state != RAMPING;
    if (frame[0] == HELLO) {
        want_welcome = true;
        return;
    }
    want_status = true;
    if (frame[0] == ASK || again)
        return;
    switch (frame[0]) {
    case CONFIGURE:
        if (size < 6 || !still || !configure(payload))
            return;
        break;
    case SET_POSITION:
        if (size < 16 || !still)
            return;
        for (uint8_t axis = 0; axis < 4; axis++)
            position[axis] = (uint32_t)word(4 + 4 * axis) << 16 | word(2 + 4 * axis);
        known_position = true;
        break;
    case RUN:
        if (!run())
            return;
        break;
    case STOP:
        if (size >= 1 && payload[0])
            rest_or_stop(STOPPED_BY_HOST);
        else
            raise_alarm(STOPPED_BY_HOST);
        break;
    case CLEAR:
        if (!still || inputs() & INPUT_EMERGENCY_STOP)
            return;
        flush();
        state = IDLE;
        alarm = NO_ALARM;
        break;
    default:
        return;
    }
    token = frame[1];
}

static void end_frame(void)
{
    if (length == 0)
        return;
    if (crc != 0 || length < 4 || length == 0xFF || broken || block_left) {
        if (!naked)
            naked = want_nak = true;
    } else {
        heard_ms = now_ms;
        if (frame[0] != DATA)
            control_came();
        else if (length >= DATA_HEAD + 2)
            data_came();
    }
}

/* Decode received bytes, but not so many at once that the player starves. Optimised for speed. */
__attribute__((optimize("O2"))) void receive(void)
{
    uint8_t tail = received_tail, left = (received_head - tail) & 127;
    if (left > 12)
        left = 12;
    uint8_t in_block = block_left, size = length;
    uint16_t sum = crc, next = spare, full = store_tail ? store_tail - 1 : STORE - 1;
    bool stream = size >= DATA_HEAD && frame[0] == DATA;
    for (; left; left--) {
        tail = (tail + 1) & 127;
        uint8_t byte = received[tail];
        if (byte == 0) {
            length = size, crc = sum, spare = next, block_left = in_block;
            end_frame();
            begin_frame();
            size = length, sum = crc, next = spare, in_block = block_left;
            stream = false;
            continue;
        }
        if (in_block == 0) {
            uint8_t before = block;
            block = byte;
            in_block = byte - 1;
            if (before == 0xFF)
                continue;
            byte = 0;
        } else {
            in_block--;
        }
        sum = _crc_ccitt_update(sum, byte);
        if (stream) {
            if (next == full) {
                broken = true;
            } else {
                store[next] = byte;
                if (++next == STORE)
                    next = 0;
            }
        } else if (size < sizeof frame) {
            frame[size] = byte;
            stream = size == DATA_HEAD - 1 && frame[0] == DATA;
        }
        if (size < 0xFF)
            size++;
    }
    received_tail = tail;
    length = size, crc = sum, spare = next, block_left = in_block;
}

/* ------------------------------------------------------------------------------------------------------------------- out */

static uint8_t code_at, code, end_at;
static uint16_t sent_crc;

static void emit(uint8_t byte)
{
    if (byte) {
        sending[end_at++] = byte;
        code++;
    } else {
        sending[code_at] = code;
        code_at = end_at++;
        code = 1;
    }
}

static void say(uint8_t byte)
{
    sent_crc = _crc_ccitt_update(sent_crc, byte);
    emit(byte);
}

static void say_word(uint16_t value)
{
    say(value);
    say(value >> 8);
}

static void say_long(uint32_t value)
{
    say_word(value);
    say_word(value >> 16);
}

static void begin_saying(uint8_t type, uint8_t sequence)
{
    code_at = 0;
    end_at = code = 1;
    sent_crc = 0xFFFF;
    say(type);
    say(sequence);
}

static void end_saying(void)
{
    uint16_t sum = sent_crc;
    emit(sum);
    emit(sum >> 8);
    sending[code_at] = code;
    sending[end_at++] = 0;
    send_at = 0;
    send_length = end_at;
    UCSR0B = UART_TALKS;
}

static void say_room(void)
{
    told_room = store_room();
    say(state);
    say_word(told_room);
}

void transmit(void)
{
    (void)UCSR0A;       /* simulators need this access to continue sending */
    if (send_at != send_length)
        return;
    if (want_welcome) {
        want_welcome = false;
        begin_saying(WELCOME, expected);
        say('c');
        say('n');
        say('c');
        say(VERSION);
        say(AXES);
        say_word(TICK_NS);
        say_word(STORE - ROOM_KEPT);
        say_word(LEAST_INTERVAL);
        say(state);
        say(known_position);
        say(AXES == 4);                     /* A2 can be the limit of the fourth output */
    } else if (want_nak) {
        want_nak = false;
        begin_saying(NAK, expected);
        say_room();
    } else if (want_status) {
        int32_t at[4];
        want_status = want_ack = false;     /* a status is also an acknowledgement */
        where(at);
        begin_saying(STATUS, token);
        say(expected);
        say_room();
        say(alarm);
        say(known_position);
        say(inputs());
        say_long(taken);
        say_word(time_left());
        for (uint8_t axis = 0; axis < 4; axis++)
            say_long(at[axis]);
        say(holds);
        say(resumes);
    } else if (want_ack || (state == RUNNING && store_room() >= told_room + 64)) {
        want_ack = false;
        begin_saying(ACK, expected);
        say_room();
    } else {
        return;
    }
    end_saying();
}
