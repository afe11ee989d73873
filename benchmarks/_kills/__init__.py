"""The parts of the benchmark that kills runs: which runs, what is the same but for times, one kill and what follows."""
