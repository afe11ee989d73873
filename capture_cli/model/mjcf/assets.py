"""Where the meshes, textures, height fields and skins of a model are, seen from elsewhere.

A model that is attached has folders of its own for them, which MuJoCo leaves out when it writes all as one file.
"""

import os
import re
from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from xml.sax.saxutils import escape, unescape

import mujoco
import numpy as np

# elements of a spec: what MuJoCo calls them, and where the compiled model has the path of each
_KINDS = {
    "meshes": (mujoco.mjtObj.mjOBJ_MESH, "mesh_pathadr"),
    "hfields": (mujoco.mjtObj.mjOBJ_HFIELD, "hfield_pathadr"),
    "skins": (mujoco.mjtObj.mjOBJ_SKIN, "skin_pathadr"),
    "textures": (mujoco.mjtObj.mjOBJ_TEXTURE, "tex_pathadr"),
}
_QUOTES = {'"': "&quot;", "'": "&apos;"}


def name_in_full(spec: mujoco.MjSpec) -> set[str]:
    """Give every asset the whole path of its file, with which it compiles wherever the model lies; returns the paths.

    What the model discards is taken from the spec, too.
    """
    model = spec.compile()  # it knows where it found them
    faces = list(_faces(spec))
    found = set()
    for elements, (kind, addresses) in _KINDS.items():
        for element in getattr(spec, elements):
            number = mujoco.mj_name2id(model, kind, element.name or Path(element.file).stem)
            if path := _path(model, getattr(model, addresses)[number]) if number >= 0 else "":
                element.file = path
                found.add(path)
    for texture, files in faces:
        texture.cubefiles = files
        found.update(filter(None, files))
    spec.strippath = False
    return found


def name_from(text: str, paths: Container[str], folders: Mapping[str, Path]) -> str:
    """The MJCF `text` with each file that is one of `paths` named from its folder.

    folders: whole paths of "texturedir", and of "meshdir" for all but textures.
    """

    def element(tag: re.Match) -> str:
        folder = folders["texturedir" if tag[1] == "texture" else "meshdir"]
        return re.sub(r'( file[a-z]*=)"([^"]*)"', lambda file: shorter(file, folder), tag[0])

    def shorter(file: re.Match, folder: Path) -> str:
        path = unescape(file[2], {entity: quote for quote, entity in _QUOTES.items()})
        return f'{file[1]}"{escape(os.path.relpath(path, folder), _QUOTES)}"' if path in paths else file[0]

    return re.sub(r"<(texture|mesh|hfield|skin)\b[^>]*>", element, text) if folders else text


def _faces(spec: mujoco.MjSpec) -> Iterator[tuple[mujoco.MjsTexture, list[str]]]:
    """Textures that are made of a file for each face, with the paths of these ("": none).

    A compiled model has the path of a texture of one file only: each is that file for once.
    """
    cubes = [(texture, list(texture.cubefiles)) for texture in spec.textures if any(texture.cubefiles)]
    paths = np.full((len(cubes), 6), "", dtype=object)
    for face in range(6 if cubes else 0):
        for texture, files in cubes:
            texture.file = files[face] or next(filter(None, files))
        model = spec.compile()
        for (texture, files), row in zip(cubes, paths, strict=True):
            row[face] = _path(model, model.tex_pathadr[texture.id]) if files[face] else ""
    for (texture, _), row in zip(cubes, paths, strict=True):
        texture.file = ""
        yield texture, list(row)


def _path(model: mujoco.MjModel, address: int) -> str:
    """The whole path that begins at `address` in the model's paths; "" where there is none (-1), or no such file."""
    if address < 0:
        return ""
    path = Path(os.fsdecode(model.paths[address : model.paths.index(b"\0", address)]))
    # of a link the name counts, which says what kind of file it is
    return str(path.parent.resolve() / path.name) if path.is_file() else ""
