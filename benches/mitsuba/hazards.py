"""Isolates the causes of the hazards in pipelines/hazards.yaml at which Mitsuba 3 fails; see docs/stress.md.

python hazards.py [--variant scalar_rgb]

- *Offset*: how far Mitsuba moves the origin of a ray from its surface, read from `SurfaceInteraction.spawn_ray`.
- *Cube*: the radiance inside a glowing cube of albedo 1/2, which is 2, by the size of the cube in units of the offset.
- *Landing*: where a ray comes down behind slabs of glass, by bisection, beside a prediction: a moved origin skips
  offset x tan(angle) of the way along the surface, at each face.
- *Gap*: the light through two slabs, by the gap between them.
- *Roulette*: the radiance inside a white cube, with Russian roulette and without.
- *Slivers*: rays that pass between narrow triangles, and between the same number of wide ones.
"""

import argparse
import math
import pathlib
import tempfile

import mitsuba as mi
import numpy as np

parser = argparse.ArgumentParser()
parser.add_argument("--variant", default="scalar_rgb")
mi.set_variant(parser.parse_args().variant)
mi.set_log_level(mi.LogLevel.Error)
T = mi.ScalarTransform4f


def camera(origin, target, fov, up):
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": T().look_at(origin=origin, target=target, up=up),
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
    }


def mean(parts, depth, spp, seed=0, roulette=5):
    integrator = {"type": "path", "max_depth": depth, "rr_depth": roulette}
    scene = mi.load_dict({"type": "scene", "integrator": integrator, **parts})
    return float(np.array(mi.render(scene, spp=spp, seed=seed))[..., :3].mean())


def level(x, y, half, up=True):
    turn = T().translate([x, y, 0]) @ T().rotate([1, 0, 0], -90 if up else 90) @ T().scale(half)
    return {"type": "rectangle", "to_world": turn}


def offset(x):
    """Of a ray that leaves a floor at x straight up."""
    scene = mi.load_dict({"type": "scene", "floor": level(x, 0, 10)})
    ray = mi.Ray3f([x, 1, 0], [0, -1, 0])
    found = scene.ray_intersect(ray)
    return float(np.ravel(found.spawn_ray(mi.Vector3f(0, 1, 0)).o.y)[0])


def cube(size, albedo=0.5, depth=1000, spp=1024, **how):
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}
    box = {"type": "cube", "to_world": T().scale(size), "flip_normals": True, "emitter": lamp, "bsdf": bsdf}
    seen = camera([0, 0, 0], [1, 0, 0], 60, [0, 1, 0])
    seen["near_clip"], seen["far_clip"] = 1e-2 * min(size, 1), 1e4 * max(size, 1)
    return mean({"sensor": seen, "box": box}, depth, spp, **how)


def slabs(faces, edge, spp):
    """Light through plane faces at 60 degrees, from a plate that ends at `edge`."""
    parts = {"sensor": camera([-math.sqrt(3), 1, 0], [0, 0, 0], 1e-6, [0, 0, 1])}
    for k, (y, index, down) in enumerate(faces):
        glass = {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
        parts[f"face{k}"] = {**level(0, y, 20, down), "bsdf": glass}
    plate = level(edge - 5, faces[-1][0] - 1, 5)
    plate["bsdf"] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    plate["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    return mean({**parts, "plate": plate}, 64, spp)


def landing(faces, epsilon):
    """Where Snell's law sends the ray, and how much shorter moved origins make the way."""
    sine, index, depth, x, short = math.sqrt(0.75), 1.0, 0.0, 0.0, 0.0
    for y, own, down in faces:
        x += (depth - y) * math.tan(math.asin(sine / index))
        depth, index = y, index * (own if down else 1 / own)
        short += epsilon * (1 + max(abs(x), abs(y))) * math.tan(math.asin(sine / index))
    return x + math.tan(math.asin(sine / index)), short


one = [(0, 1.5, True), (-1, 1.5, False)]
dense = [(0, 4.0, True), (-1, 4.0, False)]
nested = [(0, 1.5, True), (-0.3, 1.3, True), (-0.6, 1.3, False), (-1, 1.5, False)]


def gap(width):
    return [(0, 1.5, True), (-1, 1.5, False), (-1 - width, 1.5, True), (-2 - width, 1.5, False)]


def plate(width, folder):
    """1000 glowing strips of 2 m by this width, side by side."""
    rows = 1000
    low = (np.arange(rows) - rows / 2) * width
    ends = ((-1, low), (1, low), (1, low + width), (-1, low + width))
    corners = [np.stack([np.full(rows, x), y, np.zeros(rows)], 1) for x, y in ends]
    points = np.stack(corners, 1).reshape(-1, 3).astype(np.float32)
    # Neighbours share their edges exactly.
    for k in range(1, rows):
        points[4 * k : 4 * k + 2] = points[4 * k - 1], points[4 * k - 2]
    first = 4 * np.arange(rows)[:, None]
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]]).astype(np.uint32)
    mesh = mi.Mesh("plate", len(points), len(faces))
    params = mi.traverse(mesh)
    params["vertex_positions"], params["faces"] = points.ravel(), faces.ravel()
    params.update()
    path = str(pathlib.Path(folder) / f"plate-{width}.ply")
    mesh.write_ply(path)
    return mi.load_dict({"type": "scene", "plate": {"type": "ply", "filename": path, "face_normals": True}})


def misses(widths, count):
    """Camera rays from 0.2 m onto plates of narrow and of wide strips: how many miss each."""
    sensor = mi.load_dict(camera([0, 0, 0.2], [0, 0, 0], 0.4, [0, 1, 0]))
    draws = np.random.default_rng(1).uniform(0, 1, (2, count)).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        scenes = [plate(width, folder) for width in widths]
        if "llvm" in mi.variant():
            rays, _ = sensor.sample_ray(0, 0.5, mi.Point2f(*draws), mi.Point2f(0.5, 0.5))
            return [count - int(np.count_nonzero(np.array(scene.ray_test(rays)))) for scene in scenes]
        rays = [sensor.sample_ray(0, 0.5, at, [0.5, 0.5])[0] for at in draws.T]
        return [sum(not scene.ray_test(ray) for ray in rays) for scene in scenes]


epsilon = offset(0.0)
print(f"offset at the origin {epsilon:.3g} m, at 100 m {offset(100.0):.3g} m, at 1e4 m {offset(1e4):.3g} m")
for size in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 1e6):
    offsets = size / (epsilon * (1 + size))
    print(f"cube of half side {size:g} m = {offsets:.3g} offsets: radiance {cube(size):.4f}, exact 2")
for name, faces in (("index 1.5", one), ("index 4", dense), ("nested", nested), ("gap of 1 cm", gap(1e-2))):
    x, short = landing(faces, epsilon)
    low, high = -5e-3, 5e-3
    for _ in range(24):
        middle = (low + high) / 2
        low, high = (low, middle) if slabs(faces, x + middle, 4) > 0 else (middle, high)
    print(f"landing, {name}: {high * 1e3:+.4f} mm from Snell's law, predicted {-short * 1e3:+.4f} mm")
for width in (5e-5, 1e-4, 1.5e-4, 2e-4, 5e-4, 1e-3, 1e-2):
    light = slabs(gap(width), landing(gap(width), 0)[0] + 1e-2, 1024)
    print(f"gap of {width * 1e3:g} mm: light {light:.4f}, exact 0.6882")
for depth in (100, 1000):
    exact = (1 - 0.999**depth) / 0.001
    with_it, without = cube(1.0, 0.999, depth, 4096), cube(1.0, 0.999, depth, 64, roulette=depth + 1)
    print(f"white cube, {depth} segments: {with_it:.1f} with roulette, {without:.1f} without, exact {exact:.1f}")
count = 1 << 24
narrow, wide = misses((2e-6, 2e-3), count)
print(f"strips of 2e-6 m: {narrow} of {count} rays pass between them; the same rays and strips of 2e-3 m: {wide}")
