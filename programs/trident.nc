%
(The trident: a closed cubic NURBS with three prongs.)
(Hui, Wei, Gao, TELKOMNIKA 11-5, 2013, section 4, with the control points of its Figure 4.)
(K degree, U knot, W weight, F in mm/min. The last four knots stand alone.)
G21 G90 G17 (mm, absolute, XY plane)
G0 X10 Y0 Z0

G06.2 K3 U0 X10 Y0 Z0 W1 F18000
U0 X20 Y20 Z0 W1
U0 X12 Y8 Z0 W1
U0 X10 Y20 Z0 W1
U0.25 X8 Y8 Z0 W1
U0.5 X0 Y20 Z0 W1
U0.75 X10 Y0 Z0 W1
U1
U1
U1
U1
M2
%
