/* The slots of an even segment, the form of long lines: 46 cycles each, and 52 for each phase that is due.

   uint8_t even_slots(uint8_t most, int16_t budget, uint8_t ramping)

   Adds up to `most` slots to the queue within the budget of ticks that may be planned ahead, and returns their number. A slot longer than
   0x3FFF ticks is the last one (is_long). It is stored in long_ticks and long_port instead. In a ramp each slot is stretched by a factor; a
   slot that is too long after that is stored without it. */

#define __SFR_OFFSET 0
#include <avr/io.h>
#include "board.h"

/* struct segment */
#define ALWAYS 2
#define DIRECTIONS 3
#define FRACTION 4
#define INTERVAL 6
#define ADD 9
#define ONE 12
#define TWO 23
#define BUDGET 34
#define LONG_TICKS 36
#define LONG_PORT 38
#define IS_LONG 39
#define FACTOR 40

/* struct phase */
#define PHASE 0
#define PERIOD 3
#define CHANGE 6
#define PORT 9
#define STEPS 10

#define rLOW r16
#define rHIGH r17
#define rMIDDLE r24

    .global even_slots
    .text

/* The axis steps if its phase is below 1: then the period is added, and the change to the period. 1 is taken away in any case. */
    .macro  axis at
    ldd     rLOW, Y + \at + PHASE + 2
    tst     rLOW
    brne    1f
    ldd     rLOW, Y + \at + PORT
    or      r0, rLOW
    ldd     rLOW, Y + \at + STEPS
    inc     rLOW
    std     Y + \at + STEPS, rLOW
    ldd     rHIGH, Y + \at + PERIOD
    ldd     rMIDDLE, Y + \at + PERIOD + 1
    ldd     rLOW, Y + \at + PHASE
    add     rLOW, rHIGH
    std     Y + \at + PHASE, rLOW
    ldd     rLOW, Y + \at + PHASE + 1
    adc     rLOW, rMIDDLE
    std     Y + \at + PHASE + 1, rLOW
    ldd     rLOW, Y + \at + PERIOD + 2
    adc     rLOW, r1
    push    rLOW
    ldd     rLOW, Y + \at + CHANGE
    add     rHIGH, rLOW
    std     Y + \at + PERIOD, rHIGH
    ldd     rLOW, Y + \at + CHANGE + 1
    adc     rMIDDLE, rLOW
    std     Y + \at + PERIOD + 1, rMIDDLE
    ldd     rLOW, Y + \at + CHANGE + 2
    ldd     rHIGH, Y + \at + PERIOD + 2
    adc     rHIGH, rLOW
    std     Y + \at + PERIOD + 2, rHIGH
    pop     rLOW
1:  dec     rLOW
    std     Y + \at + PHASE + 2, rLOW
    .endm

even_slots:
    push    r14
    push    r15
    push    r16
    push    r17
    push    r28
    push    r29
    bst     r20, 0                          ; ramping
    movw    r26, r22                        ; budget
    mov     r25, r24                        ; slots that may still be made
    push    r24
    ldi     r28, lo8(segment)
    ldi     r29, hi8(segment)
    ldd     r14, Y + ALWAYS
    ldd     r15, Y + DIRECTIONS
    ldd     r21, Y + FRACTION
    ldd     r18, Y + INTERVAL
    ldd     r19, Y + INTERVAL + 1
    ldd     r20, Y + INTERVAL + 2
    ldd     r22, Y + ADD
    ldd     r23, Y + ADD + 1
    std     Y + IS_LONG, r1
    mov     r30, rHEAD
slot:
    mov     r0, r14
    axis    ONE
    axis    TWO
    mov     rLOW, r19
    mov     rHIGH, r20
    add     r21, r18
    adc     rLOW, r1
    adc     rHIGH, r1
    add     r18, r22
    adc     r19, r23
    ldd     r24, Y + ADD + 2
    adc     r20, r24
    brts    stretch
short_slot:
    cpi     rHIGH, 0x40
    brsh    long_slot
    ldi     r31, hi8(queue)
    st      Z+, rLOW
    st      Z+, rHIGH
    st      Z+, r0
    st      Z+, r15
    mov     rHEAD, r30
    sub     r26, rLOW
    sbc     r27, rHIGH
    dec     r25
    breq    done
    sbrs    r27, 7
    rjmp    slot
done:
    std     Y + FRACTION, r21
    std     Y + INTERVAL, r18
    std     Y + INTERVAL + 1, r19
    std     Y + INTERVAL + 2, r20
    std     Y + BUDGET, r26
    std     Y + BUDGET + 1, r27
    pop     r24
    sub     r24, r25
    pop     r29
    pop     r28
    pop     r17
    pop     r16
    pop     r15
    pop     r14
    ret
long_slot:
    std     Y + LONG_TICKS, rLOW
    std     Y + LONG_TICKS + 1, rHIGH
    std     Y + LONG_PORT, r0
    ldi     r30, 1
    std     Y + IS_LONG, r30
    dec     r25
    rjmp    done

stretch:                                    /* ticks = ticks * factor / 256; r1 is 0 behind the products, r31 keeps the port */
    mov     r31, r0
    push    r18
    push    r19
    push    r20
    push    r21
    ldd     r18, Y + FACTOR
    ldd     r19, Y + FACTOR + 1
    mul     rHIGH, r19
    mov     r20, r0                         ; r20, r24: the upper bytes, r21 the lowest
    mov     r24, r1
    mul     rLOW, r18
    mov     r21, r1
    mul     rHIGH, r18
    add     r21, r0
    adc     r20, r1
    clr     r1
    adc     r24, r1
    mul     rLOW, r19
    add     r21, r0
    adc     r20, r1
    clr     r1
    adc     r24, r1
    brne    too_long
    cpi     r20, 0x40
    brsh    too_long
    mov     rLOW, r21
    mov     rHIGH, r20
    rcall   unstretch
    rjmp    short_slot
too_long:
    rcall   unstretch
    rjmp    long_slot
unstretch:
    pop     r24                             ; the way back lies above them
    pop     r1
    pop     r21
    pop     r20
    pop     r19
    pop     r18
    push    r1
    push    r24
    clr     r1
    mov     r0, r31
    ret
