"""A measured log: what was recorded on a machine.

In: files of a logger (`readers`). Out: a `MeasuredLog` of plain arrays in SI units, its episodes one after the other,
and what is wrong with it (`checks`).
"""
