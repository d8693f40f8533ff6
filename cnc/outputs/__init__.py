"""File formats: blocks, trace, pulses, summary, SARIF, JUnit, GitHub."""
