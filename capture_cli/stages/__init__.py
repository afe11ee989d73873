"""What you run: one file = one command, and what several commands share. Only stages join files and algorithms."""
