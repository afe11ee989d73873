"""Policies and identifiers on disk, what tells one from another, and the state of a training."""
