"""What a log says before any simulation: its motion with the noise on it, and the forces that the motion needs.

In: a measured log and a task. Out: smoothed positions, velocities and accelerations with their covariance
(`smoothing`), and the generalised force that the model cannot account for, with what each declared parameter and each
effect would add to it (`force_balance`). Arrays in, arrays out; nothing is simulated over time.
"""
