"""The GRBL simulator: the serial side of GRBL 1.1 (or of grblHAL) as a Python model.

It serves tests of senders, and users without a board. It is written from GRBL's interface
documentation (``doc/markdown/interface.md``, ``commands.md``, ``jogging.md``, ``settings.md`` and
the tables in ``doc/csv`` of release 1.1), not from its code and not from our sender. The two have
only the byte port in common.

      host                     the simulator, one clock
                 _________________________________________________________________________
      write --> | wire --> RX ring (128) --> main program --> planner (15) --> steppers   |
                |  10 bits   |  overflows      one line at       trapezoids,    position  |
                |  a byte    |                 a time, waits     junctions      over time |
                |            +--> real-time bytes: ? ! ~ 0x18 0x84.. at once              |
      read <--  | wire <-- TX ring (104) <-- ok, error:n, <status>, ALARM:n               |
                |_________________________________________________________________________|

All events happen at times of one clock: a byte has come off the wire, the processor is free again,
a block has ended, a fault is due. Between two events positions follow in closed form. So a test may
advance the clock, or it may run with the real clock or faster. The same bytes at the same times
give the same answers.

:class:`cnc.simulators.grbl.grbl_simulator.GrblSimulator` is the board,
:class:`cnc.simulators.grbl.ports.GrblSimulatorPort` the host's end of its cable. ``python -m
cnc.simulators.grbl`` serves it at a pseudo-terminal.
"""
