"""Which effects does a model lack? Models are compared by what they predict of blocks that they were not fitted to.

In: a prepared log, the declared model, and every effect at every place (`candidates`). Out: the effects that hold, what
speaks against the others, ties, and the verdict (`explain`, `search`); and the experiment that would settle what is
open (`experiment`).
"""
