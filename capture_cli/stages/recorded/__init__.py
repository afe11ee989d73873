"""What a file of `capture` was made from, found again: its task, its log, its effects, an earlier estimate."""
