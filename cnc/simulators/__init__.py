"""Models of boards, for tests, demonstrations and the console."""
