"""Identifiers against each other on simulated truths: what is compared, how it is drawn, and how it is summed up."""
