"""Checks of many programs at once, in worker processes or on a cluster.

Each worker process checks one program at a time. Reports come in the order of the programs.

    check_tasks ──► thread per worker ──tasks──► python -m cnc.batch.task ──► cnc.session
        ▲                  │ ◄─────────────── reports ─────────┘
        └── by number ◄────┘

The calling process imports neither numba nor the language: the workers load them.
"""
