"""Speed of the planner, the interpolators, the reader and the boards, each against a baseline of
the same run.
"""
