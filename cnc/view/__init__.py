"""The picture of a program: its path, its feed, acceleration and jerk over time, and its text, as a
page, PNG or SVG.
"""
