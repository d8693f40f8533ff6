"""Types that all layers share: blocks, streams, diagnostics, operator requests, units."""
