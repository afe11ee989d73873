"""capture: find the parameters of a MuJoCo model from a measured log, and what the model lacks."""

__version__ = "0.1.0"
