"""What a user gets to see and to keep: summaries, files, pictures."""
