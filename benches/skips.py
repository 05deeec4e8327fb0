"""What not doing needless work saves, on against off, as one table; needs nothing but Python and a built checkout.

    cargo build --release && python3 benches/skips.py [--rounds 3] [--pipelines quickstart benchmark]

Scenes to packed sets of two pipelines: the quickstart, and the benchmark scaled down. Every run starts from a cache of
its own. Each skip is undone by what a pipeline's author would have to write without it:

- demand: the G-buffers of the previews are asked for, too, which nothing reads;
- gate and sampling first: every scene of the pool is rendered in full, then gated and sampled;
- prefix reuse: previews are of other samples than the ladders, which then begin from nothing;
- transient outputs: previews and ladders, which only packing reads, are left in the cache (on: `transient: true`);
- early cutoff: a limit of the gate moves and no verdict does; without it, all that follows the gate would run;
- specialisation: scenes of the sampling are rendered with all that they lack undone at once
  (nodes/render/examples/skips.rs).

Seconds are of wall time, medians over rounds, in each of which another run comes first. What is saved is the median of
the rounds' ratios, with the least and the most of them. Bytes are what a run left in its cache.
"""

import argparse
import json
import pathlib
import re
import shutil
import statistics
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
TAUFLOW = ROOT / "target" / "release" / "tauflow"
TARGETS = ["train_set", "test_set"]
# The quickstart's own sizes, and of the benchmark so much that it takes half a minute.
PIPELINES = {
    "quickstart": (["--profile", "tiny"], {
        "scenes.pool": 480, "split.test_share": 0.34, "sampling.train": 240, "sampling.test": 48,
        "train_ladders.rungs": "{ dyadic: 256 }", "test_ladders.rungs": "{ dyadic: 256 }",
    }, "{ dyadic: 256 }"),
    "benchmark": (["--profile", "smoke"], {
        "scenes.pool": 120, "previews.resolution": "[64, 64]", "train_ladders.resolution": "[64, 64]",
        "test_ladders.resolution": "[64, 64]", "sampling.train": 48, "sampling.test": 12,
        "train_ladders.rungs": "{ dyadic: 512 }", "test_ladders.rungs": "{ dyadic: 512 }",
    }, "{ dyadic: 512 }"),
}
EDIT = {"gate.noise": 1.001}
# Rows of the table.
DEMAND = "demand: G-buffers of previews, which nothing reads"
GATE = "gate and sampling before full renders"
PREFIX = "prefix reuse: previews are the first samples of ladders"
TRANSIENT = "transient outputs: previews and ladders are handed on in memory"
CUTOFF = "early cutoff, after an edit that moves no verdict"
SPECIAL = "specialisation, all of it at once; scenes to judge by, 16 samples, one core"


def kept(folder):
    """Bytes of the files in a folder."""
    return sum(path.stat().st_size for path in pathlib.Path(folder).rglob("*") if path.is_file())


def run(pipeline, cache, targets=TARGETS, more=(), file=None):
    """The account of a run: seconds, bytes that it left in the cache, actions."""
    arguments, params, _ = PIPELINES[pipeline]
    sets = {**params, **dict(more)}
    file = file or ROOT / "pipelines" / f"{pipeline}.yaml"
    command = [TAUFLOW, "run", file, *arguments, "--cache", cache, "--events", "json"]
    command += [word for target in targets for word in ("--target", target)]
    command += [word for name, value in sets.items() for word in ("--set", f"{name}={value}")]
    # What a run publishes goes with the scratch folder.
    command += ["--out", pathlib.Path(cache).parent / "out"]
    before = kept(cache)
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, cwd=ROOT)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stderr[-2000:]}")
    account = json.loads(done.stdout.strip().splitlines()[-1])
    return account["elapsed_s"], kept(cache) - before, account["ran"]


def sampled(pipeline, cache, scratch, more=()):
    """Names of the scenes that are sampled: sides that render others cannot be compared."""
    names = set()
    for port in ("train", "test"):
        out = pathlib.Path(tempfile.mkdtemp(prefix="sampled-", dir=scratch))
        export(pipeline, cache, f"sampling.{port}", out, more)
        names |= {f"{port}/{path.parent.name}" for path in out.rglob("scene.json")}
    assert names, "nothing was sampled"
    return names


def export(pipeline, cache, port, out, more=()):
    arguments, params, _ = PIPELINES[pipeline]
    sets = [word for name, value in {**params, **dict(more)}.items() for word in ("--set", f"{name}={value}")]
    file = ROOT / "pipelines" / f"{pipeline}.yaml"
    command = [TAUFLOW, "export", file, port, *arguments, *sets, "--cache", cache, "-o", out]
    subprocess.run([str(word) for word in command], check=True, capture_output=True, cwd=ROOT)


def transient(pipeline, folder):
    """The pipeline with outputs that are not kept."""
    shutil.copytree(ROOT / "pipelines", folder, dirs_exist_ok=True)
    file = pathlib.Path(folder) / f"{pipeline}.yaml"
    text = file.read_text()
    for node in ("previews", "train_ladders", "test_ladders"):
        text, times = re.subn(rf"(\n  {node}:\n    kind: ladder_rendering\n)", r"\1    transient: true\n", text)
        assert times == 1, node
    file.write_text(text)
    return file


def front(pipeline, scratch, turn):
    """For each skip: the accounts of a run with it, and of one without."""
    fresh = lambda name: pathlib.Path(tempfile.mkdtemp(prefix=f"{name}-", dir=scratch))
    whole = PIPELINES[pipeline][2]
    base, gating, prefix = fresh("base"), fresh("gating"), fresh("prefix")
    handed_on = transient(pipeline, fresh("pipelines"))
    runs = {
        "on": lambda: run(pipeline, base),
        DEMAND: lambda: run(pipeline, fresh("demand"), TARGETS + ["previews.gbuffer"]),
        GATE: lambda: run(pipeline, gating, more={"previews.rungs": whole}.items()),
        PREFIX: lambda: run(pipeline, prefix, more={"previews.stream": 9}.items()),
        TRANSIENT: lambda: run(pipeline, fresh("transient"), file=handed_on),
    }
    names = list(runs)
    first = turn % len(names)
    took = {name: runs[name]() for name in names[first:] + names[:first]}
    on = took.pop("on")
    found = {name: (on, off) for name, off in took.items()}
    # There the run as it is written is the one without.
    found[TRANSIENT] = (took[TRANSIENT], on)
    scenes = sampled(pipeline, base, scratch)
    # Other previews may be judged otherwise: how much of the work is the same is said below the table.
    others = {
        GATE: len(scenes - sampled(pipeline, gating, scratch, {"previews.rungs": whole}.items())),
        PREFIX: len(scenes - sampled(pipeline, prefix, scratch, {"previews.stream": 9}.items())),
    }
    edited = run(pipeline, base, more=EDIT.items())
    pool = PIPELINES[pipeline][1]["scenes.pool"]
    assert edited[2] == pool, f"the gate alone should run again, for {pool} scenes: {edited[2]} actions did"
    after = fresh("cutoff")
    run(pipeline, after, ["gate"])
    found[CUTOFF] = (edited, run(pipeline, after))
    for folder in pathlib.Path(scratch).iterdir():
        if folder != base:
            shutil.rmtree(folder)
    return found, base, others, len(scenes)


def specialisation(pipeline, cache, scratch):
    """Seconds of rendering scenes as usual, and with all undone, on one core."""
    out = pathlib.Path(tempfile.mkdtemp(prefix="scenes-", dir=scratch))
    export(pipeline, cache, "sampling.test", out)
    example = [ROOT / "target" / "examples" / "release" / "examples" / "skips", out, "64", "16", "--together"]
    told = json.loads(subprocess.run([str(w) for w in example], check=True, capture_output=True, text=True).stdout)
    return (told["usual_s"], None, told["scenes"]), (told["undone_s"], None, told["scenes"])


def size(count):
    return "–" if count is None else f"{count / 2**20:.1f} MiB"


def row(name, accounts):
    def middle(side, of):
        figures = [account[side][of] for account in accounts]
        return None if figures[0] is None else statistics.median(figures)

    (on_s, off_s), (on_b, off_b) = ((middle(0, of), middle(1, of)) for of in (0, 1))
    ratios = sorted(off[0] / max(on[0], 1e-3) for on, off in accounts)
    saved = f"{statistics.median(ratios):.2f}x ({ratios[0]:.2f} to {ratios[-1]:.2f})"
    return f"| {name} | {on_s:.2f} | {off_s:.2f} | {saved} | {size(on_b)} | {size(off_b)} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--pipelines", nargs="+", default=list(PIPELINES), choices=list(PIPELINES))
    args = parser.parse_args()
    example = ["cargo", "build", "--quiet", "--release", "-p", "tauflow-render", "--example", "skips"]
    example += ["--target-dir", "target/examples"]
    subprocess.run(example, check=True, cwd=ROOT)
    for pipeline in args.pipelines:
        accounts = {}
        for turn in range(args.rounds):
            with tempfile.TemporaryDirectory() as scratch:
                found, base, others, scenes = front(pipeline, scratch, turn)
                found[SPECIAL] = specialisation(pipeline, base, scratch)
                for name, pair in found.items():
                    accounts.setdefault(name, []).append(pair)
        print(f"\n{pipeline}, scenes to packed sets, medians of {args.rounds}: {accounts[DEMAND][0][0][2]} actions\n")
        print("| skip | on, s | off, s | time saved | on, kept | off, kept |")
        print("|---|---:|---:|---:|---:|---:|")
        for name, pairs in accounts.items():
            print(row(name, pairs), flush=True)
        for name, count in others.items():
            print(f"\n{name}: of {scenes} sampled scenes {count} are others on the side without it.")


main()
