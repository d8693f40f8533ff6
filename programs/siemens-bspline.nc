; B-splines in Siemens' words: SD degree, PL interval between knots, PW weight
; Tool 3: 8 mm ball. Zero: lower left corner, top face
G21 G90 G17 G94 G40
G54
T3 M6
S12000 M3
M8
G0 Z20

; the polygon of the programming manual, twice as large: all weights 1, then different weights
N10 G0 X20 Y20
N20 G0 Z2
N30 G1 Z-1 F400
N40 BSPLINE F2400
N50 X40 Y60
N60 X60 Y100
N70 X80 Y80
N80 X100 Y110
N90 X120 Y20
N100 G0 Z5
N110 G0 X20 Y20
N120 G1 Z-1 F400
N130 BSPLINE F2400
N140 X40 Y60 PW=2
N150 X60 Y100
N160 X80 Y80 PW=0.5
N170 X100 Y110
N180 X120 Y20
N190 G0 Z5

; a rounded square of degree 2 that comes back to its start, then a cubic in space with knots of its own:
; PL as the differences of a CAM system's knots, the 0 at point 6 a double knot
N200 G0 X180 Y20
N210 G1 Z-1 F400
N220 BSPLINE SD=2 F1800
N230 X220 Y20
N240 X220 Y100
N250 X140 Y100
N260 X140 Y20
N270 X180 Y20
N280 G0 Z5
N290 G0 X20 Y140
N300 G1 Z0 F400
N310 BSPLINE SD=3 F3000
N320 X35 Y160 Z-2 PL=0
N330 X50 Y120 Z-3 PL=0
N340 X70 Y160 Z-1 PL=0.2
N350 X90 Y120 Z-4 PL=0.2
N360 X110 Y160 Z-2 PL=0.3
N370 X125 Y130 Z-1 PL=0
N380 X140 Y140 Z0 PL=0.3
N390 G0 Z20

M9
M5
G0 X0 Y0
M30
