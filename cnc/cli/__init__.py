"""The command line: options to :mod:`cnc.api`, a report to text and an exit code.

Whatever happens, the last thing on standard error is a message that says what, where and what to
do, never a traceback. What takes long to import is imported when it is needed: ``cncrun --help``
has to be quick.
"""

import gc
import sys

gc.disable()  # nothing of what is imported here is garbage
try:
    from cnc.cli.commands import exit_code, main
except KeyboardInterrupt:
    # No command has begun yet, which would print this.
    print("stopped by the operator; nothing has moved", file=sys.stderr)
    raise SystemExit(130) from None
finally:
    gc.freeze()
    gc.enable()

__all__ = ["exit_code", "main"]
