"""Folders that tests read from."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
"""The repository."""
PROGRAMS = ROOT / "programs"
GCODE = ROOT / "tests" / "support" / "gcode"
"""Tables of G-code and folders of subroutines."""
