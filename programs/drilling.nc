%
(Canned cycles: a bolt circle and a row of holes, centred, drilled, tapped and reamed)
(Zero: centre of the circle, top face; the row begins at X 60. G98 clears the clamps at Z 20 and below, G99 stays at R)
G21 G90 G17 G94 G40 G49 G80
G54 G10 L20 P1 X-60 Y-60 Z0
G0 Z20

(Tool 1: centre drill)
T1 M6
S3000 M3 M8
F200
#<hole> = 0
o100 while [#<hole> LT 6]
  G98 G82 X[40*COS[60*#<hole>]] Y[40*SIN[60*#<hole>]] Z-3 R2 P0.2
  #<hole> = [#<hole> + 1]
o100 endwhile
(The row: under G91 R counts from the level before, Z 20, and Z from R)
X60 Y-40
G91 G99 Y20 Z-5 R-18 L4
G90 G80 G0 Z20

(Tool 2: drill 5 mm, deep holes in the circle with full retracts, the row with broken chips)
T2 M6
S2500 M3
F150
#<hole> = 0
o101 while [#<hole> LT 6]
  G98 G83 X[40*COS[60*#<hole>]] Y[40*SIN[60*#<hole>]] Z-24 R2 Q6
  #<hole> = [#<hole> + 1]
o101 endwhile
G99 G73 X60 Y-40 Z-12 R2 Q4
G91 Y20 Z-14 R-18 L4
G90 G80 G0 Z20

(Tool 3: tap M6, one millimetre a turn, in the row; tool 4: reamer in the circle)
T3 M6
S300 M3
G99 G84 X60 Y-40 Z-10 R4 F300
G91 Y20 Z-14 R-16 L4
G90 G80 G0 Z20
T4 M6
S400 M3
#<hole> = 0
o102 while [#<hole> LT 6]
  G98 G85 X[40*COS[60*#<hole>]] Y[40*SIN[60*#<hole>]] Z-22 R2 F80
  #<hole> = [#<hole> + 1]
o102 endwhile
G80
M9
M5
M30
%
