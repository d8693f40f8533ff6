"""The tests. Helpers that several tests share are in :mod:`tests.support`."""
