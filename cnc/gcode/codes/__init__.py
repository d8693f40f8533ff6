"""The effect of each G- and M-code."""
