"""Results of checks and runs, and their summary as text and as data."""
