"""The algorithms of the papers on bare curves."""
