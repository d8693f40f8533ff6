"""Types that every layer shares: blocks, streams, diagnostics, units."""
