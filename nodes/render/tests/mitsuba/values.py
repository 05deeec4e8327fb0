"""Writes values.json: what Mitsuba 3 (pip install mitsuba==3.9.1) gives for BSDFs and an environment map.

python values.py > values.json
"""

import json
import math
import random

import mitsuba as mi

mi.set_variant("scalar_rgb")
draw = random.Random(5)


def rgb(value):
    return {"type": "rgb", "value": list(value)}


def constant(*value):
    return {"type": "constant", "value": list(value if len(value) == 3 else value * 3)}


def interface(name, ior, alpha):
    ours = {"type": name, "int_ior": ior, "ext_ior": 1.0}
    plugin = {"type": name, "int_ior": ior, "ext_ior": 1.0}
    if alpha is not None:
        ours["alpha"] = alpha
        if alpha > 0:
            plugin |= {"type": "rough" + name, "distribution": "ggx", "alpha": alpha}
    return ours, plugin


def diffuse(*albedo):
    return {"type": "diffuse", "reflectance": constant(*albedo)}, {"type": "diffuse", "reflectance": rgb(albedo)}


def conductor(alpha):
    eta, k, tint = [0.2, 0.9, 1.1], [3.9, 2.4, 2.2], [1.0, 0.9, 0.8]
    ours = {"type": "conductor", "eta": eta, "k": k, "alpha": alpha, "specular_reflectance": constant(*tint)}
    plugin = {"type": "conductor", "eta": rgb(eta), "k": rgb(k), "specular_reflectance": rgb(tint)}
    if alpha > 0:
        plugin |= {"type": "roughconductor", "distribution": "ggx", "alpha": alpha}
    return ours, plugin


def glass(name, ior, alpha):
    ours, plugin = interface(name, ior, alpha)
    ours["type"] = {"thindielectric": "thin_dielectric"}.get(name, name)
    r, t = [0.9, 1.0, 0.7], [1.0, 0.8, 0.6]
    ours |= {"specular_reflectance": constant(*r), "specular_transmittance": constant(*t)}
    plugin |= {"specular_reflectance": rgb(r), "specular_transmittance": rgb(t)}
    return ours, plugin


def plastic(ior, alpha):
    ours, plugin = interface("plastic", ior, alpha)
    base = [0.9, 0.5, 0.1]
    return ours | {"diffuse_reflectance": constant(*base)}, plugin | {"diffuse_reflectance": rgb(base)}


def principled(metallic, roughness, specular, spec_trans, clearcoat, gloss):
    base = [0.8, 0.5, 0.3]
    numbers = {"specular": specular, "clearcoat": clearcoat, "clearcoat_gloss": gloss}
    shares = {"metallic": metallic, "roughness": roughness, "spec_trans": spec_trans}
    ours = {"type": "principled", "base_color": constant(*base)} | {n: constant(v) for n, v in shares.items()} | numbers
    return ours, {"type": "principled", "base_color": rgb(base)} | shares | numbers


def both(inner):
    return {"type": "two_sided", "inner": inner[0]}, {"type": "twosided", "inner": inner[1]}


def blend(weight, a, b):
    ours = {"type": "blend", "weight": constant(weight), "a": a[0], "b": b[0]}
    return ours, {"type": "blendbsdf", "weight": weight, "a": a[1], "b": b[1]}


SMOOTH = {
    "diffuse": diffuse(0.2, 0.6, 0.9),
    "metal": conductor(0.3),
    "shiny metal, two-sided": both(conductor(0.06)),
    "glass": glass("dielectric", 1.5, 0.3),
    "frosted glass": glass("dielectric", 1.33, 0.8),
    "lacquer": plastic(1.49, 0.0),
    "dense lacquer": plastic(1.9, 0.0),
    "rough plastic": plastic(1.5, 0.15),
    "rougher plastic": plastic(1.7, 0.6),
    "principled": principled(0.0, 0.5, 0.5, 0.0, 0.0, 0.0),
    "principled metal": principled(1.0, 0.4, 0.5, 0.0, 0.0, 0.0),
    "principled mix": principled(0.4, 0.7, 0.3, 0.0, 0.8, 0.7),
    "principled glass": principled(0.1, 0.5, 0.8, 0.8, 0.0, 0.0),
    "blend": blend(0.3, diffuse(0.2, 0.6, 0.9), conductor(0.3)),
}
DELTA = {
    "mirror": conductor(0.0),
    "clear glass": glass("dielectric", 1.5, 0.0),
    "pane": glass("thindielectric", 1.6, None),
}


def direction(near=None):
    while True:
        v = [draw.gauss(0, 1) for _ in range(3)]
        if near is not None:
            v = [a + 0.3 * b for a, b in zip(near, v)]
        length = math.sqrt(sum(c * c for c in v))
        if length > 0.1 and abs(v[2] / length) > 0.03:
            return [round(c / length, 6) for c in v]


def interaction(wi):
    si = mi.SurfaceInteraction3f()
    si.t = 1.0
    si.wi = mi.Vector3f(wi) / math.sqrt(sum(c * c for c in wi))
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    return si


def unit(d):
    return mi.Vector3f(d) / math.sqrt(sum(c * c for c in d))


def figures(values):
    return [float(f"{float(v):.7g}") for v in values]


result = {"smooth": [], "delta": [], "environment": {}}
for name, (ours, plugin) in SMOOTH.items():
    bsdf, cases = mi.load_dict(plugin), []
    for number in range(24):
        wo = direction()
        # Half of the pairs near the mirror direction or straight through, where lobes are high.
        near = [None, [-wo[0], -wo[1], wo[2]], None, [-c for c in wo]][number % 4]
        wi = direction(near)
        if number % 4 < 2 or number % 8 == 2:
            wo[2], wi[2] = abs(wo[2]), abs(wi[2])
        value = bsdf.eval(mi.BSDFContext(), interaction(wo), unit(wi))
        cases.append({"wo": wo, "wi": wi, "value": figures(value)})
    result["smooth"].append({"name": name, "bsdf": ours, "cases": cases})
for name, (ours, plugin) in DELTA.items():
    bsdf, cases = mi.load_dict(plugin), []
    for number in range(12):
        wo, lobe = direction(), round(draw.random(), 3)
        found, weight = bsdf.sample(mi.BSDFContext(), interaction(wo), lobe, mi.Point2f(0.3, 0.6))
        cases.append({"wo": wo, "lobe": lobe, "wi": figures(found.wo), "value": figures(weight)})
    result["delta"].append({"name": name, "bsdf": ours, "cases": cases})

width, height, scale = 6, 4, 1.5
pixels = [round(draw.uniform(0, 4), 3) for _ in range(width * height * 3)]
turn = mi.ScalarTransform4f().rotate([0, 1, 0], 40).rotate([1, 0, 0], 25)
image = mi.Bitmap(mi.TensorXf(pixels, (height, width, 3)))
emitter = mi.load_dict({"type": "envmap", "bitmap": image, "scale": scale, "to_world": turn})
cases = []
for _ in range(40):
    d = direction()
    si = interaction([-c for c in d])
    cases.append({"direction": d, "value": figures(emitter.eval(si))})
matrix = [figures([turn.matrix[r, c] for c in range(4)]) for r in range(3)]
map_of = {"width": width, "height": height, "pixels": pixels, "scale": scale, "to_world": matrix}
result["environment"] = map_of | {"cases": cases}

columns, rows = 3, 2
texels = [round(draw.uniform(0, 1), 3) for _ in range(columns * rows * 3)]
uv = [[0.8, 0.3, 0.1], [-0.2, 1.1, 0.4]]
affine = [uv[0], uv[1], [0, 0, 1]]
checks = {"type": "checkerboard", "color0": [0.1, 0.2, 0.3], "color1": [0.9, 0.8, 0.7], "scale": [3.0, 5.0]}
TEXTURES = [
    (
        {"type": "bitmap", "image": "0" * 64 + "-1", "uv": uv, "scale": [1.0] * 3, "clamp": clamp},
        {
            "type": "bitmap",
            "data": mi.TensorXf(texels, (rows, columns, 3)),
            "raw": True,
            "wrap_mode": "clamp" if clamp else "repeat",
            "to_uv": mi.ScalarTransform3f(affine),
        },
    )
    for clamp in [False, True]
] + [
    (
        checks,
        {
            "type": "checkerboard",
            "color0": rgb(checks["color0"]),
            "color1": rgb(checks["color1"]),
            # Its squares are half a unit wide.
            "to_uv": mi.ScalarTransform3f().scale([0.5 * s for s in checks["scale"]]),
        },
    )
]
result["textures"] = []
for ours, plugin in TEXTURES:
    texture, cases = mi.load_dict(plugin), []
    for _ in range(16):
        si = interaction([0, 0, 1])
        at = [round(draw.uniform(-1, 2), 4) for _ in range(2)]
        si.uv = mi.Point2f(at)
        cases.append({"uv": at, "value": figures(texture.eval(si))})
    result["textures"].append({"texture": ours, "cases": cases})


def block(entry):
    """One line for what is compared, then one for each case."""
    cases = ",\n".join("  " + json.dumps(case) for case in entry["cases"])
    head = json.dumps({key: value for key, value in entry.items() if key != "cases"})
    return head[:-1] + ', "cases": [\n' + cases + "\n]}"


print('{"mitsuba": ' + json.dumps(mi.__version__) + ",")
print(f'"image": {json.dumps({"columns": columns, "rows": rows, "texels": texels})},')
for group in ["smooth", "delta", "textures"]:
    print(f'"{group}": [\n' + ",\n".join(block(entry) for entry in result[group]) + "\n],")
print('"environment": ' + block(result["environment"]) + "}")
