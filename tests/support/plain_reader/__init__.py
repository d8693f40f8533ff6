"""A second, small reader of programs, which shares no code with the first one."""
