"""``python -m cnc.cli``."""

from cnc.cli.commands import main

main()
