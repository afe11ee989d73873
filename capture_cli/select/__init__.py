"""Which effects does a model lack? Models are compared by what they predict of blocks that they were not fitted to.

In: the force balance of a log (`estimate`) and the effects that could act. Out: how much better each of them predicts
what was not fitted, best first, with the values that a fit through the simulator begins at (`screening`).
"""
