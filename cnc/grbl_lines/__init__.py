"""Path to lines of G-code within a tolerance, for boards that plan for themselves."""
