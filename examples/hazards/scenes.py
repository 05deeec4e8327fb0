"""Writes the scenes of pipelines/hazards.yaml as Mitsuba XML, and their exact radiance in exact.json.

python3 examples/hazards/scenes.py            # writes the directory scenes
python3 examples/hazards/scenes.py --list     # prints the list of scenes for pipelines/hazards.yaml

The exact values are closed forms and quadratures in double precision; no renderer is involved. In each scene, all
pixels of the film have the same expected radiance. `demand` is the largest error that counts as correct, relative to
the exact value: 1e-6 where single precision is exact, 5e-5 where a sum of 527 equal samples is rounded (527 x 2^-24 =
3e-5), and otherwise the limit of docs/stress_table.md. Without `noise`, every sample has the exact value.
"""

import argparse
import json
import math
import pathlib
import struct

HERE = pathlib.Path(__file__).parent / "scenes"
EXACT, SUM = 1e-6, 5e-5
FILM = 8


class Scene:
    """The elements of a scene, and the answer."""

    def __init__(
        self, name, about, exact, demand, depth, origin, target, fov, up=(0, 1, 0), near=0.01, noise=True
    ):
        self.name, self.about, self.exact, self.demand = name, about, exact, demand
        self.noise, self.parts = noise and exact > 0 and demand > SUM, []
        self.head = f"""<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="{fov!r}"/>
        <float name="near_clip" value="{near!r}"/>
        <transform name="to_world"><lookat origin="{row(origin)}" target="{row(target)}" up="{row(up)}"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="{FILM}"/><integer name="height" value="{FILM}"/><rfilter type="box"/>
        </film>
    </sensor>
"""

    def shape(self, kind, bsdf, matrix=None, emission=None, flip=False, inside=""):
        """A shape with its material, and its radiance if it is a lamp."""
        lines = [f'    <shape type="{kind}">', *(f"        {line}" for line in inside.splitlines())]
        if matrix:
            lines.append(f'        <transform name="to_world"><matrix value="{row(matrix, " ")}"/></transform>')
        if flip:
            lines.append('        <boolean name="flip_normals" value="true"/>')
        lines.append(f"        {bsdf}")
        if emission is not None:
            lines.append(f'        <emitter type="area"><rgb name="radiance" value="{emission!r}"/></emitter>')
        self.parts.append("\n".join([*lines, "    </shape>\n"]))
        return self

    def sphere(self, center, radius, bsdf):
        """A ball."""
        inside = f'<point name="center" value="{row(center)}"/>\n<float name="radius" value="{radius!r}"/>'
        return self.shape("sphere", bsdf, inside=inside)

    def floor(self, bsdf, half=20.0, at=(0.0, 0.0, 0.0), up=True, emission=None):
        """A level square."""
        (x, y, z), side = at, half if up else -half
        return self.shape("rectangle", bsdf, [half, 0, 0, x, 0, 0, side, y, 0, -side, 0, z, 0, 0, 0, 1], emission)

    def sky(self, radiance=1.0):
        """The same light from all directions."""
        self.parts.append(f'    <emitter type="constant"><rgb name="radiance" value="{radiance!r}"/></emitter>\n')
        return self

    def sun(self, direction, irradiance):
        """Parallel light."""
        self.parts.append(
            f'    <emitter type="directional"><vector name="direction" value="{row(direction)}"/>'
            f'<rgb name="irradiance" value="{irradiance!r}"/></emitter>\n'
        )
        return self

    def xml(self):
        """The whole file."""
        return self.head + "".join(self.parts) + "</scene>\n"


def row(values, between=", "):
    return between.join(repr(float(value)) for value in values)


def diffuse(albedo):
    return f'<bsdf type="diffuse"><rgb name="reflectance" value="{albedo!r}"/></bsdf>'


def glass(index, alpha=0.0):
    kind = f'roughdielectric"><string name="distribution" value="ggx"/><float name="alpha" value="{alpha!r}"/>'
    start = kind if alpha else 'dielectric">'
    return f'<bsdf type="{start}<float name="int_ior" value="{index!r}"/><float name="ext_ior" value="1.0"/></bsdf>'


def mirror(alpha):
    kind = f'roughconductor"><string name="distribution" value="ggx"/><float name="alpha" value="{alpha!r}"/>'
    start = kind if alpha else 'conductor">'
    return f'<bsdf type="{start}<rgb name="eta" value="0.0"/><rgb name="k" value="10000.0"/></bsdf>'


def reflectance(cos, n):
    """Unpolarised Fresnel reflectance of a face of relative index n."""
    inside = math.sqrt(1 - (1 - cos * cos) / (n * n))
    s, p = (cos - n * inside) / (cos + n * inside), (inside - n * cos) / (inside + n * cos)
    return 0.5 * (s * s + p * p)


def ply(name, points, faces):
    """A binary PLY of triangles."""
    text = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack("<3f", *point) for point in points)
    return name, text.encode() + body + b"".join(struct.pack("<B3i", 3, *face) for face in faces)


def mesh(name):
    return f'<string name="filename" value="{name}"/>\n<boolean name="face_normals" value="true"/>'


def on_floor(name, about, exact, demand):
    """One point of a floor of albedo 1/2, seen from the side."""
    return Scene(name, about, exact, demand, 2, (0, 0.5, 2), (0, 0, 0), 1e-3).floor(diffuse(0.5))


def lamp_irradiance(half, height, away):
    """Of a floor point under a level square lamp of radiance 1: the integral of h^2/r^4."""
    cells = 200
    side = 2 * half / cells
    middles = [(k + 0.5) * side - half for k in range(cells)]
    squares = ((away + x) ** 2 + height * height + z * z for x in middles for z in middles)
    return side * side * height * height * sum(1 / (square * square) for square in squares)


def light():
    for size, irradiance in (("1e5", 1e5), ("1e8", 1e8)):
        about = f"sun of irradiance {size} on a floor of albedo 1/2"
        yield on_floor(f"sun-{size}", about, 0.5 * irradiance / math.pi, SUM).sun((0, -1, 0), irradiance)
    about = "inside a closed cube of albedo 0.9 under a sky of 1"
    room = Scene("closed-room", about, 0.0, 0.0, 50, (0, 0, 0), (1, 0, 0), 60.0)
    yield room.shape("cube", diffuse(0.9), flip=True).sky()
    away = on_floor("lamp-away", "lamp below a floor that shines away from it", 0.0, 0.0)
    yield away.floor(diffuse(0.0), 1.0, (0, -0.1, 0), False, 1.0)
    for size in ("1e-2", "1e-4", "1e-6"):
        half = float(size)
        # Single precision in files and renderers: the radiance is the rounded one.
        radiance = 1.0 / half**2
        exact = 0.5 / math.pi * radiance * lamp_irradiance(half, 2.0, 0.0)
        about = f"square lamp of half side {size} m, 2 m above a floor, the same power at every size"
        scene = on_floor(f"lamp-{size}", about, exact, 0.01)
        yield scene.floor(diffuse(0.0), half, (0, 2, 0), False, radiance)
    for size in ("1e-1", "1e-3", "1e-5"):
        angle = float(size)
        exact = 0.5 * 1e6 * math.sin(angle) / math.pi
        scene = on_floor(f"low-sun-{size}", f"sun {size} radians above the horizon", exact, SUM)
        yield scene.sun((-math.cos(angle), -math.sin(angle), 0), 1e6)
    exact = 0.5 / math.pi * lamp_irradiance(0.5, 1e-4, 3.0)
    scene = on_floor("grazing-lamp", "lamp 0.1 mm above a floor, 3 m away", exact, 0.05)
    yield scene.floor(diffuse(0.0), 0.5, (3, 1e-4, 0), False, 1.0)
    # Between texels the map is linear: the texel is a tent, an eighth of a turn wide and 60 degrees down from the pole,
    # that ends at the pole and at 120 degrees. The floor sees the part above 90.
    cells = 10_000
    tent = 0.0
    for k in range(cells):
        polar = (k + 0.5) / cells * math.pi / 2
        tent += (1 - abs(polar * 3 / math.pi - 1)) * math.sin(polar) * math.cos(polar)
    tent *= math.pi / 2 / cells
    exact = 0.5 * 1e3 * (0.125 + (65280 - 0.125) * 0.25 * tent)
    about = "environment map of 0.125 with a texel of 65280, scaled by 1000, over a floor of albedo 1/2"
    scene = on_floor("bright-texel", about, exact, 0.01)
    scene.parts.append(
        '    <emitter type="envmap"><string name="filename" value="bright-texel.hdr"/>'
        '<float name="scale" value="1000.0"/></emitter>\n'
    )
    yield scene


def furnaces():
    def ball(name, about, bsdf, depth):
        return Scene(name, about, 1.0, 2e-3, depth, (0, 0, 4), (0, 0, 0), 20.0).sphere((0, 0, 0), 1.0, bsdf).sky()

    for index in (1.0001, 1.5, 4.0):
        yield ball(f"glass-{index:g}", f"glass ball of index {index:g} under a sky of 1", glass(index), 200)
    for alpha in (0.0, 1e-3):
        about = f"perfect mirror ball of roughness {alpha:g} under a sky of 1"
        yield ball(f"mirror-{alpha:g}", about, mirror(alpha), 8)
    yield ball("rough-glass", "glass ball of index 1.5 and roughness 0.001 under a sky of 1", glass(1.5, 1e-3), 200)
    nested = ball("nested-glass", "three glass balls inside each other under a sky of 1", glass(1.5), 400)
    yield nested.sphere((0, 0, 0), 0.7, glass(1.3)).sphere((0, 0, 0), 0.4, glass(1 / 1.3))
    about = "two touching glass balls, the point of contact in view, under a sky of 1"
    touching = Scene("touching-glass", about, 1.0, 2e-3, 400, (1, 0, 4), (1, 0, 0), 20.0)
    yield touching.sphere((0, 0, 0), 1.0, glass(1.5)).sphere((2, 0, 0), 1.0, glass(1.5)).sky()
    coincident = ball("coincident-glass", "two coincident glass balls under a sky of 1", glass(1.5), 400)
    yield coincident.sphere((0, 0, 0), 1.0, glass(1.5))


def cubes():
    def cube(name, about, albedo, depth, fov=60.0, near=0.01, scale=1.0, shift=0.0):
        exact = (1 - albedo**depth) / (1 - albedo)
        at = (shift, shift, shift)
        target, noise = (shift + scale, shift, shift), depth > 1
        scene = Scene(name, about, exact, 0.01, depth, at, target, fov, near=near, noise=noise)
        matrix = [scale, 0, 0, shift, 0, scale, 0, shift, 0, 0, scale, shift, 0, 0, 0, 1]
        return scene.shape("cube", diffuse(albedo), matrix, 1.0, True)

    for depth in (1, 2, 1000):
        about = f"inside a glowing cube of albedo 1/2, at most {depth} segment{'s' * (depth > 1)}"
        yield cube(f"cube-{depth}", about, 0.5, depth)
    for depth in (100, 1000):
        about = f"inside a glowing cube of albedo 0.999, at most {depth} segments"
        yield cube(f"white-cube-{depth}", about, 0.999, depth)
    for fov in ("0.000001", "0.01", "179", "179.999"):
        about = f"inside a glowing cube of albedo 1/2, field of view of {fov} degrees"
        yield cube(f"view-{fov}", about, 0.5, 1000, float(fov), 1e-6)
    # Mitsuba shows 10 km, and exported scenes leave it at that.
    for size in ("1e-6", "1e-3", "1e3"):
        scale = float(size)
        near = min(1e-2, 1e-2 * scale)
        yield cube(f"scale-{size}", f"the same cube, scaled by {size}", 0.5, 1000, 60.0, near, scale)
    for size in ("1e2", "1e4", "1e6"):
        about = f"the same cube, moved by {size} m along every axis"
        yield cube(f"shift-{size}", about, 0.5, 1000, shift=float(size))


def refraction():
    def face(name, about, exact, demand, index, cos, plate):
        origin = (-math.sqrt(1 - cos * cos), cos, 0)
        scene = Scene(name, about, exact, demand, 4, origin, (0, 0, 0), 1e-3, (0, 0, 1), 1e-6)
        scene.floor(glass(index)).floor(diffuse(0.0), at=(0, -0.1, 0), emission=plate)
        return scene if plate else scene.sky()

    for index, cos in ((1.5, 1.0), (4.0, 1.0), (1.0001, 0.01), (4.0, 0.01)):
        about = f"sky of 1 reflected by glass of index {index:g} at a cosine of {cos:g}"
        yield face(f"reflect-{index:g}-{cos:g}", about, reflectance(cos, index), 0.03, index, cos, 0.0)
    for index, cos in ((1.0001, 1.0), (4.0, 1.0), (1.0001, 0.01), (4.0, 0.01)):
        about = f"plate of radiance 1 in glass of index {index:g}, seen at a cosine of {cos:g}"
        exact = (1 - reflectance(cos, index)) / index**2
        # From ahead, 1.0001 reflects 2.5e-9: no noise.
        demand = SUM if index < 1.1 and cos == 1 else 0.03
        yield face(f"transmit-{index:g}-{cos:g}", about, exact, demand, index, cos, 1.0)

    def one(index):
        return [(0.0, index, True), (-1.0, index, False)]

    nested = [(0.0, 1.5, True), (-0.3, 1.3, True), (-0.6, 1.3, False), (-1.0, 1.5, False)]
    apart = [(0.0, 1.5, True), (-1.0, 1.5, False), (-1.0001, 1.5, True), (-2.0001, 1.5, False)]
    for name, about, faces, copies in (
        ("slab-1.0001", "a slab of index 1.0001", one(1.0001), 1),
        ("slab-1.5", "a slab of index 1.5", one(1.5), 1),
        ("slab-4", "a slab of index 4", one(4.0), 1),
        ("slab-nested", "a slab of index 1.3 inside a slab of index 1.5", nested, 1),
        ("slab-gap", "two slabs of index 1.5, 0.1 mm apart", apart, 1),
        ("slab-twice", "two coincident slabs of index 1.5", one(1.5), 2),
    ):
        index, depth, x, share, sine = 1.0, 0.0, 0.0, 1.0, math.sqrt(0.75)
        for at, own, below in faces:
            sin, cos = sine / index, math.sqrt(1 - (sine / index) ** 2)
            x += (depth - at) * sin / cos
            depth, relative = at, own if below else 1 / own
            share *= 1 - reflectance(cos, relative)
            index *= relative
        x += sine / index / math.sqrt(1 - (sine / index) ** 2)
        # The ray comes down at x. A plate that ends 2e-5 m before x is not seen, one that ends 2e-5 m behind x is.
        for side, edge, exact, demand in (("before", x - 2e-5, 0.0, 0.0), ("behind", x + 2e-5, share, 0.01)):
            told = f"plate that ends 0.02 mm {side} the place where Snell's law sends a ray through {about}"
            scene = Scene(f"{name}-{side}", told, exact, demand, 64, (-math.sqrt(3), 1, 0), (0, 0, 0), 1e-6, (0, 0, 1))
            for at, own, below in faces:
                for _ in range(copies):
                    scene.floor(glass(own), at=(0, at, 0), up=below)
            yield scene.floor(diffuse(0.0), 5.0, (edge - 5, faces[-1][0] - 1, 0), emission=1.0)


def surfaces():
    twice = on_floor("coincident-floors", "two coincident floors of albedo 1/2 under a sky of 1", 0.5, 2e-3)
    yield twice.floor(diffuse(0.5)).sky()
    for name, distance, every, exact, demand in (
        ("slivers-0.2", 0.2, 1, 1.0, EXACT),
        ("slivers-1", 1.0, 1, 1.0, EXACT),
        ("slivers-half", 0.2, 2, 0.5, 0.01),
        ("slivers-4", 4.0, 1, 1.0, EXACT),
    ):
        about = f"glowing triangles of 2 m by 2e-6 m side by side, seen from {distance:g} m"
        about += ", every other pair omitted" if every > 1 else ""
        scene = Scene(name, about, exact, demand, 1, (0, 0, distance), (0, 0, 0), 0.08 / distance)
        yield scene.shape("ply", diffuse(0.0), emission=1.0, inside=mesh(f"slivers-{every}.ply"))
    from_below = ((2.5e-4, 0.9, 2.5e-4), (2.5e-4, 1, 2.5e-4), 0.1, (0, 0, 1))
    about = "4096 coincident triangles of radiance 1/2, which fill the view"
    heap = Scene("heap", about, 0.5, EXACT, 1, *from_below)
    yield heap.shape("ply", diffuse(0.0), emission=0.5, inside=mesh("heap.ply"))
    points = Scene("points", "4096 triangles without area, before a sky of 1", 1.0, EXACT, 1, *from_below)
    yield points.shape("ply", diffuse(0.0), inside=mesh("points.ply")).sky()

    def above(name, about, exact, demand, distance, near):
        target, large = (0, distance - 1, 0), 2 * max(10.0, distance)
        scene = Scene(name, about, exact, demand, 2, (0, distance, 0), target, 40.0, (0, 0, 1), near)
        return scene.floor(diffuse(0.5), large).sky()

    for size in ("1e-6", "1e-3", "1e3"):
        about = f"camera {size} m above a floor of albedo 1/2 under a sky of 1"
        yield above(f"camera-{size}", about, 0.5, 2e-3, float(size), 1e-7)
    for size, exact, demand in (("9e-7", 0.5, 2e-3), ("1.1e-6", 1.0, EXACT)):
        about = f"camera 1e-6 m above the same floor, near plane at {size} m"
        yield above(f"near-{size}", about, exact, demand, 1e-6, float(size))


def files():
    """Names and contents of all files."""
    scenes = [scene for part in (light, furnaces, cubes, refraction, surfaces) for scene in part()]
    for scene in scenes:
        yield f"{scene.name}.xml", scene.xml().encode()
    answers = {
        s.name: {"about": s.about, "exact": s.exact, "demand": s.demand, "noise": s.noise} for s in scenes
    }
    yield "exact.json", (json.dumps(answers, indent=1) + "\n").encode()
    # The view is 1.4 mm wide, the plate 2.
    rows, width = 1000, 2e-6
    for every in (1, 2):
        points, faces = [], []
        for k in range(0, rows, every):
            low, high, first = width * (k - rows / 2), width * (k + 1 - rows / 2), len(points)
            points += [(-1, low, 0), (1, low, 0), (1, high, 0), (-1, high, 0)]
            faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
        yield ply(f"slivers-{every}.ply", points, faces)
    yield ply("heap.ply", [(0, 1, 0), (1e-3, 1, 0), (0, 1, 1e-3)], [(0, 1, 2)] * 4096)
    yield ply("points.ply", [(0, 1, 0)] * 3, [(0, 1, 2)] * 4096)
    # Radiance: 0.125 everywhere, and one texel of 65280 = 255 x 2^8.
    texels = bytearray(bytes((128, 128, 128, 126)) * 32)
    at = 4 * (8 * 1 + 3)
    texels[at : at + 4] = bytes((255, 255, 255, 144))
    yield "bright-texel.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n" + bytes(texels)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="print the list of scenes, and write nothing")
    if parser.parse_args().list:
        for name, _ in files():
            if name.endswith(".xml"):
                print(f"        - {{ path: examples/hazards/scenes/{name}, stratum: {name.removesuffix('.xml')} }}")
    else:
        for name, content in files():
            HERE.mkdir(exist_ok=True)
            (HERE / name).write_bytes(content)
