%
(Probing: the top and the left side of a part are touched twice each, fast and slowly; then zero is set there)
(The probe: a ball of 4 mm; start above the part, 10 mm left of its side is free)
G21 G90 G17 G94 G40 G49 G80
G54
G0 X60 Y60
#<radius> = 2

o<touch> sub (#1 #2 #3: a way that should end in the part)
  G91
  G38.2 X#1 Y#2 Z#3 F300
  G0 X[-#1*0.05] Y[-#2*0.05] Z[-#3*0.05]
  G38.2 X[#1*0.1] Y[#2*0.1] Z[#3*0.1] F30
  G90
o<touch> endsub

o<touch> call [0] [0] [-20]
G10 L20 P1 Z0
(MSG, the top is at Z zero)
G91 G0 Z5
G0 X-30
G38.3 Z-10 F300
o1 if [#5070 EQ 0]
  (MSG, nothing was in the way beside the part)
o1 endif
G90
o<touch> call [20] [0] [0]
G10 L20 P1 X[-#<radius>]
G91 G0 X-2
G0 Z20
G90
M30
%
