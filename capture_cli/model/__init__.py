"""What a machine is taken to be: a compiled MuJoCo model, its open parameters, the channels of its logs, and effects.

In: an MJCF and a task.toml, or the name of a built-in task (`tasks`). Out: a `Task`, which writes the values of its
parameters into the model of each simulation (`targets`, `fields`), and the space that they span (`parameters`); what
the model may lack (`effects`); and what its sensors and constraints say of its state (`coordinate_sources`).
"""
