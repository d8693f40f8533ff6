"""Speed of each part, against a baseline of the same run."""
