"""How long a machine has been running, in a plain loop that simulates one episode."""


class Elapsed:
    """Time, s, since it was first asked: at the first step of an episode."""

    def __init__(self):
        self.began = None

    def __call__(self, time):
        if self.began is None:
            self.began = time
        return time - self.began
