"""The picture of object scooping in these pages: `MUJOCO_GL=egl python -m docs.scooping_picture`."""

from __future__ import annotations

from pathlib import Path

import mujoco
from PIL import Image

from capture_cli.context.worlds.scooping import ObjectScooping

PICTURE = Path(__file__).with_name("images") / "scooping.png"
WIDTH, HEIGHT = 720, 480
COLOURS = 256  # a quarter of the file


def main() -> None:
    """Lift a rod in balance and look at it."""
    environment = ObjectScooping(robots="Panda", com=0.3, scoop_point=0.3, control_freq=100)
    environment.lift()
    model, data = environment.sim.model._model, environment.sim.data._data
    model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
    camera, shown = mujoco.MjvCamera(), mujoco.MjvOption()
    camera.lookat[:] = [-0.1, 0.0, 1.0]
    camera.distance, camera.azimuth, camera.elevation = 1.25, 152, -14
    shown.geomgroup[:] = [0, 1, 0, 0, 0, 0]  # robosuite's visual geoms
    shown.sitegroup[:] = 0
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera, shown)
        picture = Image.fromarray(renderer.render())
    picture.quantize(COLOURS, method=Image.Quantize.FASTOCTREE).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
