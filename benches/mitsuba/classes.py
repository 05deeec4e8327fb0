"""Scenes of the sorts that cost the most, made for both renderers: FOLDER/ours and FOLDER/mitsuba; see README.md.

python classes.py FOLDER TAUFLOW

- `inside`: a bumpy ball of 1.3 million triangles, seen from within and lit by a lamp. Rays scatter in a large mesh.
- `leaves`: a crown of 4,000 leaves cut out of squares by opacity, under a sky and a lamp.
- `pictures`: six walls and three balls with a picture of 8192 x 8192 texels each, four of them different.

speed.py and agree.py take the folder as they take that of scenes.sh. TAUFLOW is the program.
"""

import argparse
import math
import pathlib
import shutil
import subprocess

import mitsuba as mi
import numpy as np

parser = argparse.ArgumentParser()
parser.add_argument("folder", type=pathlib.Path)
parser.add_argument("tauflow", type=pathlib.Path)
args = parser.parse_args()
mi.set_variant("scalar_rgb")
root = pathlib.Path(__file__).resolve().parents[2]
files = args.folder.resolve() / "files"
draws = np.random.default_rng(7)

HEAD = """<scene version="3.0.0">
    <default name="resx" value="128"/><default name="resy" value="128"/>
    <integrator type="{integrator}"><integer name="max_depth" value="{depth}"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="{fov}"/>
        <transform name="to_world"><lookat origin="{origin}" target="{target}" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="$resx"/><integer name="height" value="$resy"/><rfilter type="box"/>
        </film>
    </sensor>
"""
LAMP = """    <shape type="rectangle">
        <transform name="to_world">
            <scale value="{size}"/><rotate x="1" angle="90"/><translate x="{x}" y="{y}" z="{z}"/>
        </transform>
        <emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter>
    </shape>
"""


def ply(name, positions, faces, uvs=None):
    """A binary PLY of triangles."""
    fields = [(axis, "<f4") for axis in "xyz"] + ([] if uvs is None else [("u", "<f4"), ("v", "<f4")])
    vertices = np.zeros(len(positions), fields)
    for k, (field, _) in enumerate(fields):
        vertices[field] = positions[:, k] if k < 3 else uvs[:, k - 3]
    triangles = np.zeros(len(faces), [("n", "u1"), ("i", "<i4", 3)])
    triangles["n"], triangles["i"] = 3, faces
    properties = "".join(f"property float {field}\n" for field, _ in fields)
    with (files / name).open("wb") as out:
        out.write(
            f"ply\nformat binary_little_endian 1.0\nelement vertex {len(positions)}\n{properties}"
            f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n".encode()
        )
        out.write(vertices.tobytes() + triangles.tobytes())


def ball(bands):
    """A bumpy ball of 4 bands^2 triangles, that faces inwards."""
    theta = np.linspace(0, math.pi, bands + 1)[:, None]
    phi = np.linspace(0, 2 * math.pi, 2 * bands + 1)[None, :]
    bump = 1 + 0.1 * np.sin(9 * theta) * np.sin(7 * phi) + 0.02 * np.sin(61 * phi + theta)
    ring = np.sin(theta) * bump
    points = np.stack([ring * np.cos(phi), np.cos(theta) * bump, ring * np.sin(phi)], -1)
    row = 2 * bands + 1
    a = (np.arange(bands)[:, None] * row + np.arange(2 * bands)[None, :]).reshape(-1)
    faces = np.concatenate([np.stack([a, a + 1, a + row + 1], -1), np.stack([a, a + row + 1, a + row], -1)])
    points = points.reshape(-1, 3).astype("<f4")
    sides = [points[faces[:, k]].astype(float) for k in range(3)]
    area = np.linalg.norm(np.cross(sides[1] - sides[0], sides[2] - sides[0]), axis=1)
    return points, faces[area > 1e-12]


def inside():
    points, faces = ball(570)
    ply("inside.ply", points, faces)
    head = HEAD.format(integrator="path", depth=8, fov=70, origin="0.1, 0.05, -0.2", target="0.3, 0.1, 1")
    shape = """    <shape type="ply">
        <string name="filename" value="inside.ply"/><boolean name="face_normals" value="true"/>
        <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.7"/></bsdf></bsdf>
    </shape>
"""
    return head + shape + LAMP.format(size=0.2, x=0, y=0.7, z=0, radiance=9) + "</scene>\n"


def leaves():
    side = (np.arange(64) + 0.5) / 32 - 1
    x, y = np.meshgrid(side, side)
    cut = (x * x * (2.2 - y) + y * y * 0.9 < 0.8).astype(np.float32)
    mi.Bitmap(np.repeat((255 * cut).astype(np.uint8)[..., None], 3, 2)).write(str(files / "leaf.png"))
    at = draws.uniform(-1, 1, (12000, 3))
    at = at[(at**2).sum(1) < 1][:4000] * [1.4, 1.2, 1.4] + [0, 1.7, 0]
    a, b = draws.uniform(-0.1, 0.1, (2, 4000, 3))
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    points = np.stack([at + s * a + t * b for s, t in corners], 1).reshape(-1, 3)
    uvs = np.tile([((s + 1) / 2, (t + 1) / 2) for s, t in corners], (4000, 1))
    first = 4 * np.arange(4000)[:, None]
    ply("leaves.ply", points, np.concatenate([first + [0, 1, 2], first + [0, 2, 3]]), uvs)
    head = HEAD.format(integrator="volpath", depth=6, fov=45, origin="0, 1.5, 5", target="0, 1.6, 0")
    shapes = """    <shape type="rectangle">
        <transform name="to_world"><scale value="10"/><rotate x="1" angle="-90"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>
    </shape>
    <shape type="ply">
        <string name="filename" value="leaves.ply"/><boolean name="face_normals" value="true"/>
        <bsdf type="mask">
            <texture type="bitmap" name="opacity">
                <string name="filename" value="leaf.png"/><boolean name="raw" value="true"/>
            </texture>
            <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.5, 0.1"/></bsdf></bsdf>
        </bsdf>
    </shape>
    <emitter type="constant"><rgb name="radiance" value="0.4, 0.5, 0.6"/></emitter>
"""
    return head + shapes + LAMP.format(size=1, x=2, y=5, z=1, radiance=20) + "</scene>\n"


def pictures():
    side = 8192
    for k in range(4):
        coarse = draws.uniform(0.1, 0.9, (256, 256, 3))
        fine = np.repeat(np.repeat(coarse, side // 256, 0), side // 256, 1)
        fine += draws.uniform(-0.08, 0.08, (side, side, 1))
        mi.Bitmap((255 * fine).astype(np.uint8)).write(str(files / f"picture{k}.png"))
    picture = """<bsdf type="twosided"><bsdf type="diffuse">
            <texture type="bitmap" name="reflectance"><string name="filename" value="picture{}.png"/></texture>
        </bsdf></bsdf>"""
    places = [
        '<rotate x="1" angle="-90"/><translate y="-1"/>', '<rotate x="1" angle="90"/><translate y="1"/>',
        '<translate z="-1"/>', '<rotate y="1" angle="180"/><translate z="1"/>',
        '<rotate y="1" angle="90"/><translate x="-1"/>', '<rotate y="1" angle="-90"/><translate x="1"/>',
    ]
    shapes = "".join(
        f'    <shape type="rectangle"><transform name="to_world">{place}</transform>{picture.format(k % 4)}</shape>\n'
        for k, place in enumerate(places)
    )
    for k, at in enumerate([(-0.5, -0.65, -0.3), (0.4, -0.65, -0.5), (0.1, -0.65, 0.2)]):
        center = '<point name="center" x="{}" y="{}" z="{}"/>'.format(*at)
        radius = '<float name="radius" value="0.35"/>'
        shapes += f'    <shape type="sphere">{center}{radius}{picture.format(k + 1)}</shape>\n'
    head = HEAD.format(integrator="path", depth=8, fov=60, origin="0, 0, 0.98", target="0, -0.1, 0")
    return head + shapes + LAMP.format(size=0.4, x=0, y=0.98, z=0, radiance=8) + "</scene>\n"


files.mkdir(parents=True, exist_ok=True)
made = {"inside": inside(), "leaves": leaves(), "pictures": pictures()}
batches = root / "target/examples/release/examples/batches"
build = ["cargo", "build", "--quiet", "--release", "-p", "tauflow-render", "--example", "batches"]
subprocess.run([*build, "--target-dir", "target/examples"], cwd=root, check=True)
shutil.copy(batches, args.folder / "batches")
for name, text in made.items():
    (files / f"{name}.xml").write_text(text)
    pipeline = files / f"{name}.yaml"
    pipeline.write_text(
        f"pipeline: {name}\nnodes:\n  scenes:\n    kind: scene_files\n    params:\n      scenes:\n"
        f"        - {{ path: {files / name}.xml, stratum: L1-enclosed }}\n"
    )
    program, cache = args.tauflow.resolve(), ["--cache", args.folder.resolve() / "cache"]
    subprocess.run([program, *cache, "run", pipeline, "--target", "scenes", "--out", files / "out"], check=True)
    exported = files / "exported" / name
    shutil.rmtree(exported, ignore_errors=True)
    subprocess.run([program, *cache, "export", pipeline, "scenes", "-o", exported], check=True)
    [found] = [path for path in exported.iterdir() if path.is_dir()]
    for side in ("ours", "mitsuba"):
        shutil.rmtree(args.folder / side / name, ignore_errors=True)
        (args.folder / side).mkdir(exist_ok=True)
    shutil.copytree(found, args.folder / "ours" / name)
    size = ["--width", "128", "--height", "128"]
    subprocess.run([program, "scene", "mitsuba", found, *size, "-o", args.folder / "mitsuba" / name], check=True)
