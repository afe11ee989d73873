"""What is wrong, or worth knowing, with a measured log, before a model is blamed: findings, each with its cure.

In: a log, and where it is known the task that it belongs to. Out: findings (severity, where, message, cure), and the
log mended where that was asked for. One check = one module.
"""
