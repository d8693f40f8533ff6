"""``python -m cnc.cli``."""

from cnc.cli import main

main()
