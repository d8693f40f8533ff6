%
(Cutter compensation: the contours below are those of the part, whatever the tool)
(Tool 5: end mill 8 mm, given by G41.1 D; with a tool table: G41 D5. Zero: 20 mm left of and below the lower left corner, top face)
G21 G90 G17 G94 G40 G49 G80
G54
T5 M6
S9000 M3
M8
G0 Z20

(Around the plate, clockwise: corners outside round off, the notch inside is cut to where the tool fits)
G0 X0 Y8
G0 Z2
G1 Z-4 F300
G41.1 D8
G1 X20 Y20 F1200
Y80
X55
G2 X65 Y70 I0 J-10
G3 X85 Y70 I10 J0
G2 X95 Y80 I10 J0
G1 X120
Y50
X112
Y35
X120
Y20
X20
G40 G1 X0 Y8
G0 Z5

(A pocket with round ends, against the clock: in on an arc, out on an arc, down and along in between)
G0 X70 Y45
G1 Z-1 F300
G41.1 D8
G1 X64 Y41 F900
G3 X70 Y35 I6 J0
G1 X80
G3 X80 Y55 I0 J10 Z-3
G1 X60
G3 X60 Y35 I0 J-10
G1 X70
G3 X76 Y41 I0 J6
G40 G1 X70 Y45
G0 Z20
M30
%
