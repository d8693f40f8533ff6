"""One program on its way through both passes.

program ──► reading ──► first pass ──► second pass ──► board, or nobody
              ▲   `──── blocks again ────▲   │
              │         if need be           ├──► outputs
           memory                            `──► watch
"""

from cnc.job.job import Job
from cnc.job.outputs import Outputs
from cnc.job.reading import start_position
from cnc.job.watch import Pauses, Stage, Watch

__all__ = ["Job", "Outputs", "Pauses", "Stage", "Watch", "start_position"]
