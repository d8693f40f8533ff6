%
(Two internal threads M20 x 2.5, 15 mm deep, climb milled from the bottom upwards)
(Tool 7: thread mill, 12 mm, so the centre runs on a radius of 4 mm. Zero: top face)
G21 G90 G17 G94 G40 G49 G80
G54
T7 M6
S4500 M3
M8
G64 P0.005
G0 Z15

(First hole, at X30 Y30: six turns in one block)
G0 X30 Y30
G0 Z2
G1 Z-15 F800
G3 X34 Y30 Z-14.6875 I2 J0 F250 (roll in over half a circle, an eighth of the pitch)
G3 X34 Y30 Z0.3125 I-4 J0 P6 F350
G3 X30 Y30 Z0.625 I-2 J0 (roll out)
G0 Z15

(Second hole, at X80 Y30: one block a turn, as most posts write it)
G0 X80 Y30
G0 Z2
G1 Z-15 F800
G3 X84 Y30 Z-14.6875 I2 J0 F250
G3 Z-12.1875 I-4 J0 F350
G3 Z-9.6875 I-4 J0
G3 Z-7.1875 I-4 J0
G3 Z-4.6875 I-4 J0
G3 Z-2.1875 I-4 J0
G3 Z0.3125 I-4 J0
G3 X80 Y30 Z0.625 I-2 J0
G0 Z15

(A chamfer on both holes: a flat circle just above the thread)
G0 X34 Y30
G1 Z0.3 F600
G3 I-4 J0 F700
G0 Z5
G0 X84 Y30
G1 Z0.3 F600
G3 I-4 J0 F700
G0 Z15

M9
M5
G0 X0 Y0
M30
%
