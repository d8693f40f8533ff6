"""A model of boards with Klipper's firmware, in virtual time, written from its documentation.

host ══ cable (wire.py) ══► blocks ──► commands (commands.py) ──► motors (steppers.py)
▲                               │                   outputs (outputs.py)
└──────────── responses ◄───────┴────────────────── trsync.py: switches, timeout
"""
