"""What a command is asked: one frozen class of options per command, whose fields say how the command line has them.

The command line, the docs of options and `provenance.json` follow from the class. `base` is what all share, `shared`
has the options of several commands. A command that writes nothing has its class in its file in `cli`.
"""
