"""Compiled numerics: numbers and arrays in, a status out.

Nothing is raised here. The packages above validate and raise.
"""
