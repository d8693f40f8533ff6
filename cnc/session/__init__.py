"""One program on its way through both passes.

program ──► reading ──► first pass ──► second pass ──► board, or nobody
              ▲   `──── blocks again ────▲   │
              │         if need be           ├──► outputs
           memory                            `──► watch
"""

from cnc.session.observer import Pauses, Stage, Watch
from cnc.session.outputs import Outputs
from cnc.session.program_reader import start_position
from cnc.session.session import Job

__all__ = ["Job", "Outputs", "Pauses", "Stage", "Watch", "start_position"]
