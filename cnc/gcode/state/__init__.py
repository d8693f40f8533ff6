"""State of the interpreter: modal groups, coordinates, tools, buffered blocks."""
