"""The three papers that the interpolators come from, their experiments run again: published value
beside ours.
"""
