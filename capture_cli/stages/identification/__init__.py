"""How `identify` finds its point: which identifier, rounds over the episodes of a log, and physics."""
