"""A first task file for a model: what it could mean, and which columns of a log look like what.

In: an MJCF, and the names of a log's columns. Out: the text of a task.toml, for a person to go through.
"""
