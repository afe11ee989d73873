"""Which effects hold? They are added, dropped, and put to test against rivals (`attribution`).

In: fits of the declared model, and candidates. Out: what was accepted, with its rivals and ties, and of every other
candidate what speaks against it (`answer`).
"""
