%
(NURBS in LinuxCNC's words: G5.2 opens, P weight, L order; G5.3 closes. The knots are uniform)
(Tool 3: 8 mm ball. Zero: lower left corner, top face)
G21 G90 G17 G94 G40 G49 G80
G54
T3 M6
S12000 M3
M8
G0 Z20

(The documented curve, thirty times as large: order 3, the last point of weight 2)
G0 X20 Y20
G0 Z2
G1 Z-1 F400
G5.2 P1 L3 F2400
X20 Y50 P1
X80 Y80 P1
X80 Y20 P1
X20 Y20 P2
G5.3
G0 Z5

(A circle of 30 mm: four exact quarters, the middle point of each weighs cos 45 degrees)
G0 X180 Y50
G1 Z-1 F400
G5.2 P1 L3 F2400
X180 Y80 P0.7071067811865476
X150 Y80 P1
G5.3
G5.2 P1 L3
X120 Y80 P0.7071067811865476
X120 Y50 P1
G5.3
G5.2 P1 L3
X120 Y20 P0.7071067811865476
X150 Y20 P1
G5.3
G5.2 P1 L3
X180 Y20 P0.7071067811865476
X180 Y50 P1
G5.3
G0 Z5

(A wave in space: order 4, weights left out)
G0 X20 Y120
G1 Z0 F400
G5.2 L4 F3000
X35 Y140 Z-2
X50 Y100 Z-3
X70 Y140 Z-1
X90 Y100 Z-4
X110 Y140 Z-2
X125 Y110 Z-1
X140 Y120 Z0
G5.3
G0 Z20

M9
M5
G0 X0 Y0
M30
%
