"""Translation of a path into lines of G-code, for boards with a planner of their own."""
