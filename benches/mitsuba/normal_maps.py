"""A normal map on plain and on mirrored texture coordinates: what Mitsuba 3 gives, and what glTF says.

python normal_maps.py

One constant normal on a white square under one directional light. So the radiance is the normal times the direction of
the light, and each case has an exact value. A test of tauflow-render holds ours against the same figures:
normal_maps_turn_with_mirrored_coordinates.
"""

import math
import pathlib
import tempfile

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
CORNERS = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
PLAIN = [(0, 1), (1, 1), (1, 0), (0, 0)]
CASES = {"plain": (1, 1), "u mirrored": (-1, 1), "v mirrored": (1, -1), "half a turn": (-1, -1)}
OFF = {"use_shadowing_function": False, "flip_invalid_normals": False}


def up(x, y):
    return np.array([x, y, math.sqrt(1 - x * x - y * y)])


NORMAL, LIGHT = up(0.3, 0.5), up(0.4, 0.35)


def square(path, sx, sy):
    properties = "".join(f"property float {name}\n" for name in ["x", "y", "z", "nx", "ny", "nz", "u", "v"])
    head = f"ply\nformat ascii 1.0\nelement vertex 4\n{properties}element face 2\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    uvs = [(u if sx > 0 else 1 - u, v if sy > 0 else 1 - v) for u, v in PLAIN]
    rows = [f"{x} {y} {z} 0 0 1 {u} {v}\n" for (x, y, z), (u, v) in zip(CORNERS, uvs)]
    path.write_text(head + "".join(rows) + "3 0 1 2\n3 0 2 3\n")
    return {"type": "ply", "filename": str(path)}


def radiance(shape, flags):
    texels = np.tile(((NORMAL + 1) / 2).astype(np.float32), (2, 2, 1))
    bumps = {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(texels)}
    white = {"type": "diffuse", "reflectance": 1.0}
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "perspective",
                "fov": 15,
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0]),
                "film": film,
                "sampler": {"type": "independent", "sample_count": 4},
            },
            "light": {"type": "directional", "direction": list(-LIGHT), "irradiance": math.pi},
            "shape": shape | {"bsdf": {"type": "normalmap", "normalmap": bumps, "inner": white} | flags},
        }
    )
    return float(np.array(mi.render(scene)).mean())


print(f"{'coordinates':12} {'by default':>10} {'both off':>10} {'glTF':>10}")
with tempfile.TemporaryDirectory() as folder:
    for name, (sx, sy) in CASES.items():
        shape = square(pathlib.Path(folder) / "square.ply", sx, sy)
        exact = float(NORMAL * [sx, sy, 1] @ LIGHT)
        print(f"{name:12} {radiance(shape, {}):10.5f} {radiance(shape, OFF):10.5f} {exact:10.5f}")
