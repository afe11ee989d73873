"""MJCF in and out: a user's model compiled, with what is wrong said first; and one written with identified values."""
