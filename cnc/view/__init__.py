"""Pictures of a program as an HTML page, PNG or SVG: path, feed, acceleration, jerk and text."""
