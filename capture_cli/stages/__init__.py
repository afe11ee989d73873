"""What you run: one file = one command = one kind of output. Only stages join files and algorithms."""
