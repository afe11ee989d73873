"""From a log to parameters: the log made ready, its force balance, initial states and noise, and fits by simulation.

In: a measured log and a task. Out: a `PreparedLog` (`prepare`): windows, initial states with their covariance, noise
floor, what is held out; what the motion needs and the model does not give (`balance`); the best point of a model with
its intervals (`model_fits`, `solve`); what it predicts of what was not fitted (`prediction`, `held_out`).
"""
