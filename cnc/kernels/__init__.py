"""Compiled numerics: scalars and arrays in, a status out, nothing raised. The shells above validate
and raise.
"""
