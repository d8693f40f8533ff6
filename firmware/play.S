/* The fast interrupts. Each has its own registers (board.h), so that it need not save any.

   Timer1 compare A, an event is due: write its prepared byte to the port, then prepare the next event. 47 cycles.

       event k      port D: directions and steps of k, at once
                    Timer0 compare A is set to the end of the pulse
                    event k+1 is taken from the queue: its time to Timer1's compare register, its port byte to rPORT, its directions to rIDLE
       pulse end    port D: directions of k+1, no steps: they can settle until event k+1

   Timer0 runs freely. Without a pulse, its compare interrupt writes the present byte again. If another interrupt delays both, the chip takes
   Timer1's first, and two pulses would become one. In this case the event ends the pulse and waits for the rest. */

#define __SFR_OFFSET 0
#include <avr/io.h>
#include "board.h"

    .global TIMER1_COMPA_vect, TIMER0_COMPA_vect, USART_RX_vect, USART_UDRE_vect
    .global queue

    .section .bss
    .balign 256
queue: .skip 256

    .text

TIMER1_COMPA_vect:
    sbic  TIFR0, OCF0A
    rjmp  pulse_may_be_under_way
event:
    out   PORTD, rPORT
#if AXES == 4
    sbrc  rPORT, 0
    sbi   PORTB, 4
#endif
    in    rSREG, SREG
    movw  rZ, r30
    in    r30, TCNT0
    add   r30, rWIDTH
    out   OCR0A, r30
    sbi   TIFR0, OCF0A              ; what was left of an earlier round of Timer0
    cp    rTAIL, rHEAD
    breq  nothing_to_wait_for
    mov   r30, rTAIL
    ldi   r31, hi8(queue)
    ld    rTEMP, Z+
    add   rDUE_LOW, rTEMP
    ld    rTEMP, Z+
    adc   rDUE_HIGH, rTEMP
    ld    rPORT, Z+
    ld    rIDLE, Z+
    mov   rTAIL, r30
    lds   r30, TCNT1L
    lds   r31, TCNT1H
    add   r30, rGAP                 ; the pulse under way and as long a gap have to be over by then
    clr   rTEMP
    adc   r31, rTEMP
    cp    rDUE_LOW, r30
    cpc   rDUE_HIGH, r31
    brmi  as_soon_as_can_be
    movw  r30, rDUE_LOW
as_soon_as_can_be:
    sts   OCR1AH, r31
    sts   OCR1AL, r30
leave:
    movw  r30, rZ
    out   SREG, rSREG
    reti

pulse_may_be_under_way:
    in    rSREG, SREG
    movw  rZ, r30
    in    r30, PORTD
    andi  r30, PORT_STEPS
    movw  r30, rZ
    breq  no_pulse
    out   PORTD, rIDLE
#if AXES == 4
    cbi   PORTB, 4
    sbrc  rIDLE, 1
    sbi   PORTB, 5
    sbrs  rIDLE, 1
    cbi   PORTB, 5
#endif
    sbi   TIFR0, OCF0A
    lds   r30, TCNT1L
    lds   r31, TCNT1H
    add   r30, rGAP
    clr   rTEMP
    adc   r31, rTEMP
    rjmp  as_soon_as_can_be
no_pulse:
    out   SREG, rSREG
    rjmp  event

nothing_to_wait_for:
    ldi   r30, 0
    sts   TIMSK1, r30
    mov   r30, rPORT
    andi  r30, PORT_DIRECTIONS
    mov   rIDLE, r30
    ldi   r30, 1
    sts   parked, r30
    rjmp  leave

TIMER0_COMPA_vect:
    out   PORTD, rIDLE
#if AXES == 4
    cbi   PORTB, 4
    sbrc  rIDLE, 1
    sbi   PORTB, 5
    sbrs  rIDLE, 1
    cbi   PORTB, 5
#endif
    reti

/* A byte from the host: into a ring of 128, which is never full, for the host has no more than 96 under way. 28 cycles. */
USART_RX_vect:
    in    rSREG, SREG
    movw  rZ, r30
    lds   r30, received_head
    lds   rTEMP, UDR0
    inc   r30
    andi  r30, 127
    sts   received_head, r30
    ldi   r31, 0
    subi  r30, lo8(-(received))
    sbci  r31, hi8(-(received))
    st    Z, rTEMP
    rjmp  leave

/* Room for a byte to the host: the next one of the frame that goes out; behind its last one this interrupt is switched off. 29 cycles. */
USART_UDRE_vect:
    in    rSREG, SREG
    movw  rZ, r30
    lds   r30, send_at
    lds   rTEMP, send_length
    cp    r30, rTEMP
    breq  all_sent
    inc   r30
    sts   send_at, r30
    ldi   r31, 0
    subi  r30, lo8(-(sending - 1))
    sbci  r31, hi8(-(sending - 1))
    ld    rTEMP, Z
    sts   UDR0, rTEMP
    rjmp  leave
all_sent:
    ldi   r30, UART_LISTENS
    sts   UCSR0B, r30
    rjmp  leave
