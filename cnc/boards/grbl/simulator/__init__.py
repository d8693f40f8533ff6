"""A GRBL board in a simulator: the serial side of GRBL 1.1 (or of grblHAL) as a Python model, for tests
of senders and for users without a board.

Written from GRBL's interface documentation (``doc/markdown/interface.md``, ``commands.md``,
``jogging.md``, ``settings.md`` and the tables in ``doc/csv`` of release 1.1), not from its code and
not from our sender: the two meet at the byte port alone.

      host                        the simulator, one clock
                 ___________________________________________________________________
      write --> | wire --> RX ring (128) --> main program --> planner (15) --> steppers |
                |  10 bits   |  overflows      one line at       trapezoids,    position |
                |  a byte    |                 a time, waits     junctions      over time|
                |            +--> real-time bytes: ? ! ~ 0x18 0x84.. at once              |
      read <--  | wire <-- TX ring (104) <-- ok, error:n, <status>, ALARM:n               |
                |________________________________________________________________________|

Everything in the simulator happens at moments of one clock: a byte that has come off the wire, a
processor that is free again, a block that has been moved through, a fault that was asked for.
Between two such moments positions follow in closed form, so the clock may be stepped by a test, run
in step with the wall's or faster, and the same bytes at the same moments give the same answers.

:class:`cnc.boards.grbl.simulator.grbl_simulator.GrblSimulator` is the board,
:class:`cnc.boards.grbl.simulator.ports.GrblSimulatorPort` the host's end of its cable, and ``python -m
cnc.boards.grbl.simulator`` puts it behind a pseudo-terminal.
"""
