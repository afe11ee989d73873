"""A measured log: what was recorded on a machine.

In: files of a logger (`readers`). Out: a `MeasuredLog` of plain arrays in SI units, its episodes one after the other;
windows of it (`windows`), its inputs at the steps of a model (`input_sequences`), and what is wrong with it (`checks`).
"""
