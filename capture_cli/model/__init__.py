"""What a machine is taken to be: a compiled MuJoCo model, its open parameters, and the channels of its logs.

In: an MJCF and a task.toml, or the name of a built-in task (`tasks`). Out: a `Task`, which writes the values of its
parameters into the model of each simulation, and the space that they span (`parameters`).
"""
