"""What the judgement of a model rests on, worked out from arrays alone: nothing is simulated here."""
