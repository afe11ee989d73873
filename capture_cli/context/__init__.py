"""The paper's system: identification in context, by a transformer that has read many adaptations.

In: a task of actions. Out: policies that choose them (`policies`), histories of walks from wrong to right parameters
(`search`, `histories`), networks that find parameters round by round and their rivals (`identifiers`, `checkpoints`),
their evaluation on simulated truths (`evaluation`), and scenes that stand in for a real machine (`worlds`).
"""
