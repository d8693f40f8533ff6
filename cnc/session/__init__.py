"""One program, from its file to the board.

program ──► reader ──► check pass ──► run pass ──► board, or none
              ▲   `── blocks again ────▲   │
              │       if necessary         ├──► output files
        saved state                        `──► callbacks
"""
