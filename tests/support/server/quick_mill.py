"""The machine file of the tests in a browser: a quick mill, so that they wait less."""

MILL = """\
[machine]
name = "Quick mill"
[path]
max_feed = 100
tolerance = 0.01
[board]
kind = "grbl"
max_step_rate = 30_000
"""
AXIS = """\
[axes.{letter}]
steps_per_mm = 200
max_velocity = {velocity}
max_acceleration = 2000
max_jerk = 100_000
travel = [{low}, 0]
homing = {{ seek = {velocity}, latch = 20, pull_off = 1, end = "high" }}
"""
PLATE, PLATE_THICKNESS = -22.0, 10.0
"""Machine position of the top of the touch plate, and its thickness, mm."""
SECONDS = 120
"""For each wait. A wait ends when what it waits for is there, so this only limits a failure."""
