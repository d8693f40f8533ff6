"""Many programs at once: each worker process checks one at a time, and reports come in the order of
the programs.

    check_many ──► a thread a worker ──tasks──► python -m cnc.batch.worker ──► cnc.session
        ▲                  │ ◄─────────────── reports ─────────┘
        └── by number ◄────┘

This side imports neither numba nor the language: while the workers load them, it has nothing to do
but wait.
"""
