"""The picture of table air hockey in these pages: `MUJOCO_GL=egl python -m docs.air_hockey_picture`."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from capture_cli.context.worlds.air_hockey import TableAirHockey

PICTURE = Path(__file__).with_name("images") / "air_hockey.png"
WIDTH, HEIGHT = 720, 480
COLOURS = 256  # a quarter of the file
ACTION = np.array([-0.25, -0.06, 0.0, 0.5])


def main() -> None:
    """Strike a puck and look at where it is in the end."""
    environment = TableAirHockey(robots="Panda", parameters={}, mallet=ACTION[:2], control_freq=100)
    environment.strike(ACTION)
    model, data = environment.sim.model._model, environment.sim.data._data
    model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
    camera, shown = mujoco.MjvCamera(), mujoco.MjvOption()
    camera.lookat[:] = [0.02, 0.0, 0.95]
    camera.distance, camera.azimuth, camera.elevation = 1.5, 140, -32
    shown.geomgroup[:] = [0, 1, 0, 0, 0, 0]  # robosuite's visual geoms
    shown.sitegroup[:] = 0
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera, shown)
        picture = Image.fromarray(renderer.render())
    picture.quantize(COLOURS, method=Image.Quantize.FASTOCTREE).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
