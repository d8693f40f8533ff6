%
(A lathe: M20 x 1.5 outside with G76, then a centre hole tapped with G33.1; X words are diameters)
(Zero: axis and face of the part. The thread's relief groove is at Z-22)
G21 G90 G18 G95 G40 G49 G80 G7
G54
G97 S600 M3
G0 X26 Z4
G76 P1.5 Z-20 I-6 J0.5 K1.84 R2 Q29.5 H2 E1.5 L2
G0 X40 Z10
M5

G97 S300 M3
G0 X0 Z5
G33.1 Z-12 K1
G0 Z20
M5
M30
%
