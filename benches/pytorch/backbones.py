"""Published generative backbones at 256 x 256, ours and PyTorch's one after the other: one prediction on the CPU.

python backbones.py [--threads 1 2] [--rounds 3] [--side 256]

Needs diffusers beside PyTorch, and `cargo build --release -p tauflow-generative --example backbone_time`. Both sides
have made-up weights: the time does not depend on them. PyTorch runs eagerly, without gradients, in both of its memory
layouts; the faster one counts, round by round. Each round runs every program once in a process of its own. Figures are
medians over the rounds; ratios are medians of the rounds' ratios, with the least and the most.

The NCSN++ in PyTorch is written here by the same description as ours: BigGAN residual blocks, the filter 1 3 3 1,
attention at 16 pixels.
"""

import argparse
import json
import math
import pathlib
import statistics
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]


def church():
    """diffusers' network in the layout of google/ddpm-church-256."""
    from diffusers import UNet2DModel

    down = ["AttnDownBlock2D" if i == 4 else "DownBlock2D" for i in range(6)]
    up = ["AttnUpBlock2D" if i == 1 else "UpBlock2D" for i in range(6)]
    return UNet2DModel(
        sample_size=256,
        block_out_channels=(128, 128, 256, 256, 512, 512),
        down_block_types=down,
        up_block_types=up,
        downsample_padding=0,
        flip_sin_to_cos=False,
        freq_shift=1,
        norm_eps=1e-6,
        attention_head_dim=None,
    )


def lsun():
    """An NCSN++ of the layout of Rectified Flow's LSUN models."""
    import torch
    from torch import nn
    from torch.nn import functional as F

    taps = torch.tensor([1.0, 3.0, 3.0, 1.0]) / 8
    kernel = torch.outer(taps, taps)[None, None]

    def resample(x, up):
        weight = kernel.repeat(x.shape[1], 1, 1, 1)
        if up:
            return F.conv_transpose2d(x, 4 * weight, stride=2, padding=1, groups=x.shape[1])
        return F.conv2d(x, weight, stride=2, padding=1, groups=x.shape[1])

    def norm(channels):
        return nn.GroupNorm(min(channels // 4, 32), channels, eps=1e-6)

    class Block(nn.Module):
        def __init__(self, inputs, outputs, up=None):
            super().__init__()
            self.up = up
            self.norms = nn.ModuleList([norm(inputs), norm(outputs)])
            self.convs = nn.ModuleList([nn.Conv2d(n, outputs, 3, padding=1) for n in (inputs, outputs)])
            self.time = nn.Linear(512, outputs)
            self.skip = nn.Conv2d(inputs, outputs, 1) if inputs != outputs or up is not None else nn.Identity()

        def forward(self, x, time):
            h = F.silu(self.norms[0](x))
            if self.up is not None:
                h, x = resample(h, self.up), resample(x, self.up)
            h = self.convs[0](h) + self.time(time)[:, :, None, None]
            return (self.skip(x) + self.convs[1](F.silu(self.norms[1](h)))) / math.sqrt(2)

    class Attention(nn.Module):
        def __init__(self, channels):
            super().__init__()
            self.norm = norm(channels)
            self.maps = nn.ModuleList([nn.Conv2d(channels, channels, 1) for _ in range(4)])

        def forward(self, x):
            h = self.norm(x)
            q, k, v = [m(h).flatten(2).transpose(1, 2) for m in self.maps[:3]]
            h = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(x.shape)
            return (x + self.maps[3](h)) / math.sqrt(2)

    class Network(nn.Module):
        def __init__(self):
            super().__init__()
            widths = [128 * n for n in (1, 1, 2, 2, 2, 2, 2)]
            self.register_buffer("frequencies", 16 * torch.randn(128))
            self.time = nn.ModuleList([nn.Linear(256, 512), nn.Linear(512, 512)])
            self.stem = nn.Conv2d(3, 128, 3, padding=1)
            self.down, self.smaller, self.bring = nn.ModuleList(), nn.ModuleList(), nn.ModuleList()
            skips, at = [128], 128
            for level, width in enumerate(widths):
                blocks = nn.ModuleList()
                for _ in range(2):
                    blocks.append(nn.ModuleList([Block(at, width)] + ([Attention(width)] if level == 4 else [])))
                    at = width
                    skips.append(at)
                self.down.append(blocks)
                if level < 6:
                    self.smaller.append(Block(at, at, up=False))
                    self.bring.append(nn.Conv2d(3, at, 1))
                    skips.append(at)
            self.middle = nn.ModuleList([Block(at, at), Attention(at), Block(at, at)])
            self.up, self.image = nn.ModuleList(), nn.ModuleList()
            for level, width in reversed(list(enumerate(widths))):
                blocks = nn.ModuleList()
                for _ in range(3):
                    blocks.append(Block(at + skips.pop(), width))
                    at = width
                attention = Attention(at) if level == 4 else nn.Identity()
                twice = Block(at, at, up=True) if level else None
                self.up.append(nn.ModuleList([blocks, attention] + ([twice] if twice else [])))
                self.image.append(nn.Sequential(norm(at), nn.SiLU(), nn.Conv2d(at, 3, 3, padding=1)))

        def forward(self, x, t):
            phases = torch.log(t)[:, None] * self.frequencies[None] * 2 * math.pi
            time = self.time[0](torch.cat([phases.sin(), phases.cos()], 1))
            time = F.silu(self.time[1](F.silu(time)))
            x = small = 2 * x - 1
            x = self.stem(x)
            skips = [x]
            for level, blocks in enumerate(self.down):
                for block, *attention in blocks:
                    x = block(x, time)
                    x = attention[0](x) if attention else x
                    skips.append(x)
                if level < 6:
                    small = resample(small, False)
                    x = self.bring[level](small) + self.smaller[level](x, time)
                    skips.append(x)
            x = self.middle[2](self.middle[1](self.middle[0](x, time)), time)
            image = None
            for (blocks, attention, *twice), head in zip(self.up, self.image):
                for block in blocks:
                    x = block(torch.cat([x, skips.pop()], 1), time)
                x = attention(x)
                image = head(x) if image is None else resample(image, True) + head(x)
                x = twice[0](x, time) if twice else x
            return image / t[:, None, None, None]

    return Network()


def measure(name, threads, side, times):
    """Milliseconds of a prediction in PyTorch, in both memory layouts."""
    import torch

    torch.set_num_threads(threads)
    network = (church() if name == "ddpm" else lsun()).eval()
    found = {"weights": sum(p.numel() for p in network.parameters())}
    for layout in (torch.contiguous_format, torch.channels_last):
        network = network.to(memory_format=layout)
        x = torch.rand(1, 3, side, side).to(memory_format=layout)
        taken = []
        with torch.no_grad():
            for _ in range(times + 1):
                start = time.perf_counter()
                network(x, torch.tensor([499.5]))
                taken.append(1000 * (time.perf_counter() - start))
        found[str(layout)] = statistics.median(taken[1:])
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--side", type=int, default=256)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measure(options.measure, options.threads[0], options.side, options.times)))
        return
    rest = [str(options.side), str(options.times)]
    for name in ("ddpm", "rectified_flow"):
        for threads in options.threads:
            ours, theirs = [], []
            for _ in range(options.rounds):
                program = ROOT / "target/release/examples/backbone_time"
                ours.append(json.loads(subprocess.check_output([program, name, str(threads), *rest])))
                command = [sys.executable, __file__, "--measure", name, "--threads", str(threads), "--side", rest[0]]
                theirs.append(json.loads(subprocess.check_output([*command, "--times", rest[1]])))
            best = [min(v for k, v in one.items() if k != "weights") for one in theirs]
            ratios = sorted(a["predict_ms"] / b for a, b in zip(ours, best))
            print(
                f"{name}, {threads} threads: ours {statistics.median(o['predict_ms'] for o in ours):.0f} ms"
                f" ({ours[0]['weights']:,} weights), PyTorch {statistics.median(best):.0f} ms"
                f" ({theirs[0]['weights']:,}), ratio {statistics.median(ratios):.2f}"
                f" ({ratios[0]:.2f} to {ratios[-1]:.2f})"
            )


if __name__ == "__main__":
    main()
