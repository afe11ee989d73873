"""What is done with a log, whatever command asks: made ready, models fitted to it and compared, effects accepted."""
