"""The state of the interpreter: modal groups, coordinates, tools."""
