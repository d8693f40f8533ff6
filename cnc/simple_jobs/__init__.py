"""Programs of simple jobs, made from a few lengths: surfacing, pockets, slots, holes, text."""
