%
(The trident with the control points as the paper prints them: lopsided, and not its Figure 4.)
(Hui, Wei, Gao, TELKOMNIKA 11-5, 2013, section 4. See trident.nc for the symmetric curve.)
G21 G90 G17 (mm, absolute, XY plane)
G0 X10 Y10 Z0

G06.2 K3 U0 X10 Y10 Z0 W1 F18000
U0 X20 Y10 Z0 W1
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
