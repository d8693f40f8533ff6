%
(Bezier curves: G5 cubic, G5.1 quadratic, in the planes XY and ZX)
(Tool 3: 8 mm ball. Zero: lower left corner, top face)
G21 G90 G17 G94 G40 G49 G80
G54
T3 M6
S12000 M3
M8
G0 Z20

(A disc of 60 mm: four cubics, a quarter each, the last three going on where the one before ended)
(Off the true circle by 0.008 mm: 16.568542 is 4/3 of tan 22.5 degrees of the radius)
G0 X90 Y60
G0 Z2
G1 Z-1 F400
G5 X60 Y90 I0 J16.568542 P16.568542 Q0 F2400
G5 X30 Y60 P0 Q16.568542
G5 X60 Y30 P-16.568542 Q0
G5 X90 Y60 P0 Q-16.568542
G0 Z5

(A clover leaf: a stem in an S, then three loops)
G0 X130 Y20
G1 Z-1 F400
G5 X150 Y50 I5 J15 P-5 Q-15 F1800
G5 X150 Y50 I50 J45 P-50 Q45
G5 X150 Y50 I-60 J10 P-20 Q-50
G5 X150 Y50 I20 J-50 P60 Q10
G0 Z5

(A parabola down to Y50 and back on a flatter one above: G5.1 X Y and one control point)
G0 X200 Y90
G1 Z-1 F400
G5.1 X260 Y90 I30 J-80 F2400
G5.1 X200 Y90 I-30 J20
G0 Z5

(A trough across X: the profile stands in the plane ZX, where P goes with Z and Q with X)
G0 X20 Y130
G1 Z0 F400
G18
G5 X60 Z-6 I12 K0 P0 Q-14 F1500
G5 X100 Z0 P0 Q-12
G5.1 X140 I20 K-8
G17
G0 Z20

M9
M5
G0 X0 Y0
M30
%
