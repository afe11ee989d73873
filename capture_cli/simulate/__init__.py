"""What the sensors would have reported: a task with its effects, stepped many times at once.

In: parameters, initial states and inputs. Out: states and sensors of many simulations in lockstep (`engine`), outputs
at the times of a log (`simulator`), which counts every simulation; and signals that excite a machine (`multisine`).
"""
