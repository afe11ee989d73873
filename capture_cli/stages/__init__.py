"""What a command does: files in, files out. One command = one module, and what several commands share.

In: paths and options. Out: a result folder or store, written whole, and its document. Only stages join files and
algorithms; algorithms take arrays and return arrays. Commands do not import each other.
"""
