"""Path and limits to a jerk-limited plan s(t)."""
