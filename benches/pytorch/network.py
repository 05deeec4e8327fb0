"""Our network and PyTorch's version of it, one after the other: a training step and a prediction; see README.md.

python network.py [--presets tiny small base fast best wide] [--threads 1 2] [--rounds 5] [--preload PATH ...]

PyTorch runs in both of its memory layouts, by itself and with each allocator that is preloaded (our program has
mimalloc). It runs eagerly, and with --compile also through torch.compile, whose own time does not count. The fastest
counts, round by round. Both sides do forward and backward pass, a clip of the
gradient's norm, Adam and the average of the weights, on 64 x 64 crops with G-buffers. Predictions are of a 256 x 256
image.

Each round runs every program once in a process of its own. Figures are medians over the rounds of medians in a round.
Ratios are medians of the rounds' ratios, with the least and the most. GFLOP/s are ours, by what PyTorch counts in
convolutions and products of matrices.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
BATCH = {"tiny": 8, "small": 4, "base": 4, "fast": 8, "best": 4, "wide": 4}
STEPS = {"tiny": 30, "small": 15, "base": 6, "fast": 30, "best": 15, "wide": 12}
# The network itself is that of the package.
sys.path.insert(0, str(ROOT / "python"))


def peer(preset, threads, layout, compiled):
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    from tauflow._network import CHANNELS, CLOCK, bases, network, sides

    torch.set_num_threads(threads)
    torch.manual_seed(1)
    form = torch.channels_last if layout == "nhwc" else torch.contiguous_format
    net = network(preset).to(memory_format=form)
    weights = list(net.parameters())
    average = [w.detach().clone() for w in weights]
    adam = torch.optim.Adam(weights, lr=1e-4, fused=True)
    call = torch.compile(net, dynamic=False) if compiled else net

    def inputs(count, side):
        image = lambda channels: torch.randn(count, channels, side, side).to(memory_format=form)
        # Ours makes them in each step; PyTorch is given them.
        ours = image(CHANNELS), torch.randn(count, CLOCK), bases(image(3), sides(preset))
        return *ours, image(3), image(3), torch.ones(count, 1, 1, 1)

    def step():
        adam.zero_grad(set_to_none=True)
        loss = (call(*batch) - target).square().mean()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(weights, 1.0)
        adam.step()
        with torch.no_grad():
            torch._foreach_lerp_(average, weights, 0.001)
        return loss.item()

    def median(f, times):
        f(), f(), f()
        found = []
        for _ in range(times):
            start = time.perf_counter()
            f()
            found.append(1000 * (time.perf_counter() - start))
        return statistics.median(found)

    batch, target = inputs(BATCH[preset], 64), torch.randn(BATCH[preset], 3, 64, 64).to(memory_format=form)
    step_ms = median(step, STEPS[preset])
    batch = inputs(1, 256)
    net.eval()
    with torch.inference_mode():
        predict_ms = median(lambda: call(*batch), STEPS[preset])
    with FlopCounterMode(display=False) as predicted, torch.inference_mode():
        net(*batch)
    net.train()
    batch, call = inputs(BATCH[preset], 64), net
    with FlopCounterMode(display=False) as stepped:
        step()
    count = sum(w.numel() for w in weights)
    flop = {"step_flop": stepped.get_total_flops(), "predict_flop": predicted.get_total_flops()}
    print(json.dumps({"step_ms": step_ms, "predict_ms": predict_ms, "weights": count, **flop}))


def run(command, threads, preload=""):
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads), "LD_PRELOAD": preload}
    pinned = ["taskset", "-c", ",".join(str(core) for core in range(threads))]
    words = pinned + [str(c) for c in command]
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=True)
    return json.loads(done.stdout.strip().splitlines()[-1])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--presets", nargs="*", default=list(BATCH))
    parser.add_argument("--threads", nargs="*", type=int, default=[1, 2])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--compile", action="store_true", help="PyTorch runs compiled, too")
    parser.add_argument("--peer", nargs=4, help=argparse.SUPPRESS)
    parser.add_argument("--preload", nargs="*", default=[], help="allocators that PyTorch runs with, too")
    parser.add_argument("--ours", default=ROOT / "target/release/examples/network_time", help="the program of our side")
    args = parser.parse_args()
    if args.peer:
        preset, threads, layout, compiled = args.peer
        return peer(preset, int(threads), layout, bool(compiled))
    modes = ["", "compiled"] if args.compile else [""]
    ways = [
        (layout, preload, compiled)
        for layout in ("nchw", "nhwc")
        for preload in ["", *args.preload]
        for compiled in modes
    ]
    of = "GFLOP/s | PyTorch | ratio"
    print(f"| preset | threads | step | {of} | prediction | {of} | drawing | fastest |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|")
    for preset in args.presets:
        for threads in args.threads:
            ours, peers = [], []
            for _ in range(args.rounds):
                ours.append(run([args.ours, preset, threads, BATCH[preset], STEPS[preset], STEPS[preset]], threads))
                script = [sys.executable, __file__, "--peer", preset, threads]
                peers.append({way: run([*script, way[0], way[2]], threads, way[1]) for way in ways})
                assert all(peer["weights"] == ours[-1]["weights"] for peer in peers[-1].values()), "the same network"
            cells, fastest = [preset, threads], []
            for what in ("step_ms", "predict_ms"):
                best = [min(round, key=lambda way: round[way][what]) for round in peers]
                theirs = [round[way][what] for round, way in zip(peers, best)]
                mine = [round[what] for round in ours]
                ratios = sorted(a / b for a, b in zip(mine, theirs))
                ratio = f"{statistics.median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})"
                rate = next(iter(peers[0].values()))[what.replace("_ms", "_flop")] / statistics.median(mine) / 1e6
                took, other = (f"{statistics.median(times):.1f} ms" for times in (mine, theirs))
                cells += [took, f"{rate:.0f}", other, ratio]
                fastest.append(" ".join(filter(None, statistics.mode(best))))
            cells.append(f"{100 * statistics.median(round['draw_share'] for round in ours):.1f}%")
            cells.append(", ".join(fastest))
            print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


if __name__ == "__main__":
    main()
