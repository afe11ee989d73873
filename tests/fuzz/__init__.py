"""Hostile inputs of every kind that `capture` reads, and the rule that it keeps to on all of them.

One file for each kind (kinds.py names them): `seeds`, inputs whose end is known, and `cases`, a strategy of hypothesis.
"""
