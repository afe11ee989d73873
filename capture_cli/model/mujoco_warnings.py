"""MuJoCo's own warnings, kept out of the terminal."""

import mujoco


def silence_mujoco() -> None:
    """Keep MuJoCo's warnings out of the terminal and of MUJOCO_LOG.TXT; the batch counts them per simulation."""
    config = mujoco.MjLogConfig.get()
    config.logto_console = False
    config.logto_file = False
    mujoco.MjLogConfig.set(config)
