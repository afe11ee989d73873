"""The force balance of a log: what its motion needs, less what the model gives, and what would fill the gap.

In: a measured log and a task. Out: smoothed motion with its covariance (`motion`), the missing generalised force with
what each declared parameter and each effect would add to it (`force_balance`), and how well a model (`balanced_fits`),
or each addition to it (`screening`), predicts blocks that were not fitted. Nothing is simulated over time.
"""
