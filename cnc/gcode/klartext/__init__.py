"""Heidenhain Klartext: the rules of its grammar, and the steps of its blocks."""
