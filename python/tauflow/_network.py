"""The network of trained models in PyTorch, and how weights and images become its inputs: docs/formats/model.md."""

import math

import torch
from torch import nn
from torch.nn import functional as F

PLANS = {
    "tiny": ([32, 64, 96], 1, 1, 64),
    "small": ([48, 96, 160], 1, 2, 128),
    "base": ([96, 192, 384], 2, 2, 256),
    "fast": ([32, 48, 64, 96], 1, 1, 64),
    "best": ([40, 80, 96, 144], 1, 2, 64),
    "wide": ([64, 80, 96, 144], 1, 2, 64),
}
# Presets whose output at a pixel depends only on its surroundings.
LOCAL = ("fast", "best", "wide")
# Outputs with a shading factor.
SHADED = ("shaded_means", "guided_means", "smoothed_means", "fitted_means")
# Outputs whose weights G-buffers guide.
GUIDED = ("guided_means", "smoothed_means", "fitted_means")
# Outputs with a weighted mean of albedo.
SMOOTH = ("smoothed_means", "fitted_means")
CHANNELS, CLOCK = 15, 14
BLACK, BARE, FLOOR, STEEPEST = 0.02, 0.25, 0.05, 16.0
SHARPNESS, FARTHEST = 16.0, 8.0
# Albedo is smoothed over windows of this side; this is added to the number of the pixel itself.
SMOOTHED, ITSELF = 5, 6.0
# Local models of the light: sides of blocks, blocks on each side of a block, the number of the mean, and bounds.
BLOCK, RADII, OWN = 4, (2, 4, 8), 4.0
RIDGE, BRIGHTEST, MOST = 1e-3, 1e4, 4.0


def sides(preset):
    """Sides of the windows of weights, at blocks of 1, 2, 4 ... pixels."""
    return (5, 3, 3, 3, 3) if preset in LOCAL else (5, 3, 3, 3)


def numbers_of(preset, output):
    """Numbers of the last layer for a pixel."""
    return 3 if output == "values" else sum(side * side for side in sides(preset))


def strengths_of(preset):
    """Strengths of guides for a pixel: of albedo and of normals, at each scale."""
    return 2 * len(sides(preset))


def multiple(preset):
    """Height and width of inputs are multiples of this."""
    return 2 ** max(len(PLANS[preset][0]), len(sides(preset)) - 1)


def network(preset, channels=CHANNELS, output="means", log=False):
    """The network of a preset; see docs/formats/model.md."""
    widths, blocks, convolutions, embedding = PLANS[preset]
    numbers = numbers_of(preset, output)

    class Step(nn.Module):
        def __init__(self, channels, out=None):
            super().__init__()
            self.norm = nn.Identity() if preset in LOCAL else nn.GroupNorm(channels // 8, channels, affine=False)
            self.time = nn.Linear(embedding, 2 * channels)
            self.conv = nn.Conv2d(channels, out or channels, 3, padding=1)

        def before(self, x, time):
            scale, shift = self.time(time)[:, :, None, None].chunk(2, 1)
            return F.silu(torch.addcmul(shift, self.norm(x), 1 + scale))

        def forward(self, x, time):
            return self.conv(self.before(x, time))

    class Block(nn.Module):
        def __init__(self, channels):
            super().__init__()
            self.steps = nn.ModuleList(Step(channels) for _ in range(convolutions))

        def forward(self, x, time):
            branch = x
            for step in self.steps:
                branch = step(branch, time)
            return x + branch

    class Unet(nn.Module):
        def __init__(self):
            super().__init__()
            level = lambda width: nn.ModuleList(Block(width) for _ in range(blocks))
            first, second = nn.Linear(CLOCK, embedding), nn.Linear(embedding, embedding)
            self.time = nn.Sequential(first, nn.SiLU(), second, nn.SiLU())
            self.stem = nn.Conv2d(4 * channels, widths[0], 3, padding=1)
            self.down = nn.ModuleList(level(w) for w in widths[:-1])
            self.smaller = nn.ModuleList(nn.Conv2d(4 * a, b, 1) for a, b in zip(widths, widths[1:]))
            self.middle = level(widths[-1])
            self.larger = nn.ModuleList(nn.Conv2d(b, 4 * a, 1) for a, b in reversed(list(zip(widths, widths[1:]))))
            self.skip = nn.ModuleList(nn.Conv2d(w, w, 1) for w in reversed(widths[:-1]))
            self.up = nn.ModuleList(level(w) for w in reversed(widths[:-1]))
            self.last = Step(widths[0], 4 * numbers)
            if output in SHADED:
                self.shade = nn.Conv2d(widths[0], 4 * 3, 3, padding=1)
            if output in GUIDED:
                self.guide = nn.Conv2d(widths[0], 4 * strengths_of(preset), 3, padding=1)
            if output == "fitted_means":
                self.fits = nn.Conv2d(4 * 3 * len(RADII), widths[0], 3, padding=1)
                self.blend = nn.Conv2d(widths[0], 4 * len(RADII), 3, padding=1)
            if output in SMOOTH:
                self.smooth = nn.Conv2d(widths[0], 4 * SMOOTHED**2, 3, padding=1)

        def forward(self, x, clock, bases, albedo, state, gain, distances=None, models=None):
            time = self.time(clock)
            x = self.stem(F.pixel_unshuffle(x, 2))
            if output == "fitted_means":
                x = x + self.fits(F.pixel_unshuffle(signed_log1p(models), 2))
            skips = []
            for level, smaller in zip(self.down, self.smaller):
                for block in level:
                    x = block(x, time)
                skips.append(x)
                x = smaller(F.pixel_unshuffle(x, 2))
            for block in self.middle:
                x = block(x, time)
            for level, larger, skip in zip(self.up, self.larger, self.skip):
                x = F.pixel_shuffle(larger(x), 2) + skip(skips.pop())
                for block in level:
                    x = block(x, time)
            x = self.last.before(x, time)
            answer = F.pixel_shuffle(self.last.conv(x), 2)
            if output == "values":
                return answer
            if output in GUIDED:
                answer = answer - guided(distances, F.pixel_shuffle(self.guide(x), 2), sides(preset))
            # One product of matrices (einsum) for it takes two to three times as long.
            shares = answer.softmax(1)
            mean = torch.stack([(bases[:, colour] * shares).sum(1) for colour in range(3)], 1)
            if output == "fitted_means":
                mean = blended(mean, models, F.pixel_shuffle(self.blend(x), 2))
            if output in SHADED:
                power = F.pixel_shuffle(self.shade(x), 2).exp()
                mean = mean * (1 + 4 * power) / (4 + power)
            if output in SMOOTH:
                albedo = smoothed(albedo, F.pixel_shuffle(self.smooth(x), 2))
            mean = albedo * mean
            return gain * ((mean.sign() * mean.abs().log1p() if log else mean) - state)

    return Unet()


def bases(light, sides=(5, 3, 3, 3)):
    """What lies around each pixel of [N, 3, H, W] at each scale: [N, 3, weights, H, W]."""
    found = []
    for scale, side in enumerate(sides):
        small = F.avg_pool2d(light, 2**scale) if scale else light
        count, colours, height, width = small.shape
        padded = F.pad(small, (side // 2,) * 4, mode="replicate")
        around = F.unfold(padded, side).view(count, colours, side * side, height, width)
        found.append(around.repeat_interleave(2**scale, 3).repeat_interleave(2**scale, 4))
    return torch.cat(found, 2)


def distances(gbuffer, sides):
    """Squared distances of albedo and of normals to those of the pixel, [N, 2, weights, H, W]."""
    of = lambda x: (bases(x, sides) - x[:, :, None]).square().sum(1).clamp(max=FARTHEST)
    return torch.stack([of(gbuffer[:, :3]), of(gbuffer[:, 3:])], 1)


def guided(distances, strengths, sides):
    """How much the numbers [N, weights, H, W] fall, for strengths [N, scales x 2, H, W]."""
    each = strengths.unflatten(1, (len(sides), 2)).transpose(1, 2)
    places = torch.tensor([side * side for side in sides], device=strengths.device)
    return SHARPNESS * (distances * each.repeat_interleave(places, 2)).sum(1)


def smoothed(albedo, numbers):
    """Weighted means of albedo [N, 3, H, W], for numbers [N, SMOOTHED^2, H, W]."""
    own = torch.zeros(SMOOTHED**2, dtype=numbers.dtype, device=numbers.device)
    own[SMOOTHED**2 // 2] = ITSELF
    shares = (numbers + own[:, None, None]).softmax(1)
    return (bases(albedo, (SMOOTHED,)) * shares[:, None]).sum(2)


def fits(light, gbuffer):
    """The light [N, 3, H, W] by local linear models in normal and mean albedo: [N, 9, H, W]."""
    guide = torch.cat([gbuffer[:, 3:], gbuffer[:, :3].mean(1, keepdim=True)], 1)
    dimmed, guides = light.clamp(-BRIGHTEST, BRIGHTEST), guide.shape[1]
    products = (guide[:, :, None] * guide[:, None]).flatten(1, 2)
    mixed = (guide[:, :, None] * dimmed[:, None]).flatten(1, 2)
    blocks = F.avg_pool2d(torch.cat([guide, dimmed, products, mixed], 1), BLOCK)
    found = []
    for radius in RADII:
        # Windows may be larger than the image, and are cut at its edge.
        sums = lambda x: F.avg_pool2d(F.pad(x, (radius,) * 4), 2 * radius + 1, stride=1, divisor_override=1)
        means = (sums(blocks) / sums(torch.ones_like(blocks))).permute(0, 2, 3, 1)
        g, light_mean, pairs, mixes = means.split([guides, 3, guides**2, 3 * guides], 3)
        covariance = pairs.unflatten(3, (guides, guides)) - g[..., :, None] * g[..., None, :]
        covariance = covariance + RIDGE * torch.eye(guides, dtype=g.dtype, device=g.device)
        mixed = mixes.unflatten(3, (guides, 3)) - g[..., :, None] * light_mean[..., None, :]
        slopes = torch.linalg.solve(covariance, mixed)
        constants = light_mean - (slopes * g[..., :, None]).sum(3)
        model = torch.cat([slopes.flatten(3), constants, light_mean], 3).permute(0, 3, 1, 2)
        model = F.interpolate(model, scale_factor=BLOCK, mode="bilinear", align_corners=False)
        slopes, constants, mean = model.split([3 * guides, 3, 3], 1)
        value = (slopes.unflatten(1, (guides, 3)) * guide[:, :, None]).sum(1) + constants
        most = MOST * mean
        found.append(torch.maximum(torch.minimum(value, most.clamp(min=0)), most.clamp(max=0)))
    return torch.cat(found, 1)


def blended(mean, models, numbers):
    """The mean [N, 3, H, W] with the models [N, 9, H, W], for numbers [N, 3, H, W] of the models."""
    shares = torch.cat([torch.full_like(numbers[:, :1], OWN), numbers], 1).softmax(1)
    each = torch.cat([mean[:, None], models.unflatten(1, (len(RADII), 3))], 1)
    return (each * shares[:, :, None]).sum(1)


def channels(info):
    wide, narrow = {"contrast": (15, 6), "covered": (15, 6), "plain": (9, 3)}[info.get("features", "contrast")]
    return wide if has_gbuffer(info) else narrow


def has_gbuffer(info):
    return info["conditioning"] == "gbuffer"


def shapes(preset, channels, output="means"):
    """Our matrices: names and shapes."""
    widths, blocks, convolutions, embedding = PLANS[preset]
    found = {"time.0": (CLOCK, embedding), "time.1": (embedding, embedding), "stem": (9 * 4 * channels, widths[0])}

    def level(name, width):
        for block in range(blocks):
            for step in range(convolutions):
                found[f"{name}.{block}.{step}.time"] = (embedding, 2 * width)
                found[f"{name}.{block}.{step}"] = (9 * width, width)

    for i, (width, lower) in enumerate(zip(widths, widths[1:])):
        level(f"down.{i}", width)
        found[f"down.{i}.out"] = (4 * width, lower)
        found[f"up.{i}.in"] = (lower, 4 * width)
        found[f"up.{i}.skip"] = (width, width)
        level(f"up.{i}", width)
    level("middle", widths[-1])
    found["last.time"] = (embedding, 2 * widths[0])
    found["head"] = (9 * widths[0], 4 * numbers_of(preset, output))
    if output in SHADED:
        found["shade"] = (9 * widths[0], 4 * 3)
    if output in GUIDED:
        found["guide"] = (9 * widths[0], 4 * strengths_of(preset))
    if output == "fitted_means":
        found["fits"] = (9 * 4 * 3 * len(RADII), widths[0])
        found["blend"] = (9 * widths[0], 4 * len(RADII))
    if output in SMOOTH:
        found["smooth"] = (9 * widths[0], 4 * SMOOTHED**2)
    return {f"{name}.{part}": shape if part == "kernel" else (1, shape[1])
            for name, shape in found.items() for part in ("kernel", "bias")}


def place(name, levels):
    """Where a layer of ours is in PyTorch's network, whose levels on the way up begin with the lowest."""
    first, *rest = name.split(".")
    up = lambda i: levels - 1 - int(i)
    if first == "time":
        return f"time.{2 * int(rest[0])}"
    if first in ("stem", "fits", "blend", "shade", "guide", "smooth"):
        return first
    if first == "head":
        return "last.conv"
    if first == "last":
        return "last.time"
    if first == "down" and rest[1] == "out":
        return f"smaller.{rest[0]}"
    if first == "up" and rest[1] in ("in", "skip"):
        return f"{'larger' if rest[1] == 'in' else 'skip'}.{up(rest[0])}"
    if first == "middle":
        level = "middle"
    else:
        level, rest = f"{first}.{rest[0] if first == 'down' else up(rest[0])}", rest[1:]
    block, step, *time = rest
    return f"{level}.{block}.steps.{step}.{'time' if time else 'conv'}"


def layout(name, kernel, bias):
    """A layer's weights as PyTorch has them.

    Four pixels in the channels of one: ours pixel by pixel, PyTorch's channel by channel.
    """
    outputs = kernel.shape[1]
    if name in ("head", "blend", "shade", "guide", "smooth") or name.endswith(".in"):
        turn = lambda w: w.reshape(-1, 4, outputs // 4).transpose(1, 2).reshape(-1, outputs)
        kernel, bias = turn(kernel), turn(bias)
    steps = name.split(".")[-1].isdigit() and not name.startswith("time")
    size = 3 if name in ("stem", "fits", "head", "blend", "shade", "guide", "smooth") or steps else 1
    weight = kernel.reshape(size, size, -1, outputs)
    if name in ("stem", "fits") or name.endswith(".out"):
        weight = weight.reshape(size, size, 4, -1, outputs).transpose(2, 3).reshape(size, size, -1, outputs)
    weight = weight.permute(3, 2, 0, 1)
    return (weight[:, :, 0, 0] if "time" in name else weight), bias.reshape(-1)


def state_dict(ours, preset):
    """Our matrices as the weights of PyTorch's network."""
    theirs, levels = {}, len(PLANS[preset][0]) - 1
    for name in sorted({name.rsplit(".", 1)[0] for name in ours}):
        weight, bias = layout(name, ours[f"{name}.kernel"], ours[f"{name}.bias"])
        theirs[f"{place(name, levels)}.weight"], theirs[f"{place(name, levels)}.bias"] = weight, bias
    return theirs


def signed_log1p(x):
    return x.sign() * x.abs().log1p()


def signed_expm1(x):
    return x.sign() * x.abs().expm1()


def uncovered(normal):
    """The share of each pixel [1, 1, H, W] without a surface, from mean normals [1, 3, H, W]."""
    length = normal.norm(dim=1, keepdim=True).clamp(max=1)
    least = -F.max_pool2d(-length, 3, stride=1, padding=1)
    return (1 - length) * (1 - least / BARE).clamp(min=0)


def features(info, state, gbuffer):
    """[1, C, H, W] of a state [1, 3, H, W] and a G-buffer [1, 6, H, W], with light and albedo."""
    around = lambda x: F.avg_pool2d(x, 5, stride=1, padding=2, count_include_pad=False)
    radiance = signed_expm1(state) if info["space"] == "log1p" else state
    albedo = torch.ones_like(state) if gbuffer is None else gbuffer[:, :3].clamp(min=0) + BLACK
    if gbuffer is not None and info.get("features") == "covered":
        albedo = albedo + uncovered(gbuffer[:, 3:])
    light = radiance / albedo
    if info.get("features") == "plain":
        return torch.cat([state] if gbuffer is None else [state, gbuffer], 1), light, albedo
    seen = signed_log1p(light)
    mean = around(seen)
    spread = (mean.abs() + around((seen - mean).abs())).expm1() - mean.abs().expm1()
    found = [seen, signed_log1p((light - signed_expm1(mean)) / (FLOOR + spread))]
    if gbuffer is not None:
        found += [gbuffer, signed_log1p(radiance)]
    return torch.cat(found, 1), light, albedo


def exponent(info):
    """The exponent of the error in the training ladders, n^-exponent; files of independent samples lack it."""
    return float(info.get("exponent", 0.5))


def independent(info, count):
    """How many independent samples have the error of so many."""
    return count ** (2 * exponent(info))


def ladder(info, tau):
    """First and last sample count, and that at tau, each as many independent samples."""
    first, last = (independent(info, info["counts"][i]) for i in (0, -1))
    return first, last, (first**-0.5 - tau * (first**-0.5 - last**-0.5)) ** -2


def clock(info, tau):
    if tau is None:
        return torch.zeros(1, CLOCK, dtype=torch.float64)
    _, last, count = ladder(info, tau)
    angles = [math.pi * 2 ** (k / 2 - 1) * tau for k in range((CLOCK - 2) // 2)]
    waves = [wave(angle) for angle in angles for wave in (math.sin, math.cos)]
    return torch.tensor([[tau, math.log(count) / math.log(last), *waves]], dtype=torch.float64)


def gain(info, tau):
    if tau is None:
        return -1.0
    first, last, count = ladder(info, tau)
    unit, kind, rest = first**-0.5 - last**-0.5, info["parameterization"], min(max(1 - tau, 0.0), 1.0)
    if kind == "mc_noise":
        return count / last - 1
    if kind == "mc_velocity":
        return unit * (count**0.5 + count / last**0.5)
    # Files of earlier versions lack the field, and keep the factors that they were trained with.
    if info.get("law", "limits") == "limits":
        return 2 * unit * count**0.5 if kind == "local_velocity" else min(1 / max(1 - tau, 1e-9), STEEPEST)
    if kind == "local_velocity":
        return unit * count**0.5 * (1 + ratio([independent(info, n) for n in info["counts"]], count))
    return rest * (1 - first / last) / (rest**2 + (1 - rest**2) * first / last)


def ratio(counts, count):
    """sqrt(n/next) at a sample count, linear in log n between rungs."""
    steps = [(math.log(n), (n / after) ** 0.5) for n, after in zip(counts, counts[1:])]
    log = math.log(count)
    if log <= steps[0][0]:
        return steps[0][1]
    for (a, low), (b, high) in zip(steps, steps[1:]):
        if log <= b:
            return low + (high - low) * (log - a) / (b - a)
    return steps[-1][1]


def predict(info, net, state, gbuffer, tau):
    """The prediction [H, W, 3] for a state [H, W, 3] and a G-buffer [H, W, 6], or None, in f64.

    `tau` is None if the sample count is unknown.
    """
    height, width, _ = state.shape
    whole = multiple(info["preset"])
    beyond = (0, -width % whole, 0, -height % whole)
    plane = lambda x: F.pad(x.permute(2, 0, 1)[None], beyond, mode="replicate")
    state, gbuffer = plane(state), plane(gbuffer) if has_gbuffer(info) else None
    shown, light, albedo = features(info, state, gbuffer)
    with torch.inference_mode():
        windows = sides(info["preset"])
        apart = distances(gbuffer, windows) if info.get("output") in GUIDED else None
        models = fits(light, gbuffer) if info.get("output") == "fitted_means" else None
        found = net(shown, clock(info, tau), bases(light, windows), albedo, state, gain(info, tau), apart, models)
    return found[0, :, :height, :width].permute(1, 2, 0)
