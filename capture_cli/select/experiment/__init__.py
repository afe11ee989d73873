"""The next experiment: what it would add to an estimate, what it would tell apart, and how far a machine may go."""
