"""How far a perfect model would be from a log, and whether a fit leaves more than that."""
