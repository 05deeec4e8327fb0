#!/usr/bin/env python3
"""Time per action of the executors, for a node of short programs, beside Snakemake for the same copies.

    python3 benches/executors.py PROGRAM [--actions 200] [--rounds 3] [--executors NAMES] [--slurm]
        [--hyperqueue PYTHON] [--snakemake SNAKEMAKE]

It prints the median wall time of a run from an empty cache, and the time per action beyond the first executor. Then it
generates as many scenes, pushes them to an upstream, and prints the time of a run with an empty cache that finds all of
them there, and of a second run with this cache.

NAMES are threads,process,command,slurm,hyperqueue by default, as far as they are there, and, with a program SNAKEMAKE,
snakemake and snakemake-slurm. --slurm starts Slurm with one node of two processors on this machine, as the tests do
(root, slurm-wlm, munge); otherwise Slurm must run. PYTHON has the package hyperqueue, and takes the place of `hq`.
Snakemake's environment needs snakemake-executor-plugin-slurm; it runs each copy as a job of its own.
"""

import argparse
import contextlib
import os
import pathlib
import shutil
import statistics
import subprocess
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent

PIPELINE = """\
pipeline: short
seed: 1
nodes:
  numbers:
    kind: command
    params:
      run: [sh, numbers.sh]
      mode: gather
      outputs: { numbers: tauflow/files }
  copies:
    kind: command
    inputs: { numbers: numbers }
    params:
      run: [cp, -r, in/numbers/., out/copies]
      inputs: { numbers: tauflow/files }
      outputs: { copies: tauflow/files }
"""

SNAKEFILE = """\
rule all:
    input: expand("copies/{{n}}", n=range(1, {} + 1))
rule copy:
    input: "numbers/{{n}}"
    output: "copies/{{n}}"
    resources: runtime=5, mem_mb=100, cpus_per_task=1, slurm_partition="all"
    shell: "cp {{input}} {{output}}"
"""

SCENES = """\
pipeline: scenes
seed: 1
nodes:
  scenes:
    kind: scene_generation
    params: {{ pool: {} }}
"""

SHELL = [
    "--submit", "setsid sh {script} > {log} 2>&1 < /dev/null & echo $!",
    "--poll", "ps -o pid=,stat= -p $(echo {ids} | tr ' ' ,) | awk '$2 !~ /Z/ { print $1, \"running\" }'",
    "--cancel", "kill {ids}",
]  # fmt: skip


# Slurm has no accounting here, and one processor is a job's.
SNAKEMAKE_SLURM = [
    "--executor", "slurm", "--slurm-no-account", "--slurm-status-command", "squeue", "--jobs", "100",
    "--seconds-between-status-checks", "3", "--slurm-init-seconds-before-status-checks", "3",
]  # fmt: skip


def timed(folder, *words):
    begun = time.monotonic()
    said = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    return time.monotonic() - begun, said.stderr


def seconds(options, executor, folder, cache):
    if executor.startswith("snakemake"):
        for left in ("copies", ".snakemake"):
            shutil.rmtree(folder / left, ignore_errors=True)
        how = SNAKEMAKE_SLURM if executor == "snakemake-slurm" else ["--cores", "2"]
        taken, _ = timed(folder, options.snakemake, *how)
        assert len(list((folder / "copies").iterdir())) == options.actions
        return taken
    words = ["--executor", executor, *(SHELL if executor == "command" else [])]
    return timed(folder, options.program, "run", "short.yaml", "--cache", cache, *words)[0]


@contextlib.contextmanager
def slurm(folder):
    """Slurm on this machine, and an `srun` that finds it also where its variables are removed."""
    script, at = ROOT / "tests/support/slurm.sh", folder / "slurm"
    subprocess.run(["sh", script, "start", at, str(os.getpid())], check=True, stdout=subprocess.DEVNULL)
    os.environ["SLURM_CONF"] = str(at / "slurm.conf")
    program(folder / "bin/srun", f'SLURM_CONF={at}/slurm.conf exec {shutil.which("srun")} "$@"')
    try:
        yield
    finally:
        subprocess.run(["sh", script, "stop", at], check=False)


@contextlib.contextmanager
def hyperqueue(folder, python):
    """A server of HyperQueue with a worker of two cores, and the tests' program in place of `hq`."""
    program(folder / "bin/hq", f"exec {python} {ROOT}/tests/support/hq.py \"$@\"")
    os.environ["HQ_SERVER_DIR"] = str(folder / "hq")
    words = [folder / "bin/hq", "serve", "2"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        for line in server.stdout:
            if line.strip() == "ready":
                break
        try:
            yield
        finally:
            server.stdin.close()


def program(path, line):
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"#!/bin/sh\n{line}\n")
    path.chmod(0o755)


def warm(program, folder, cache, rounds):
    """Seconds of runs that find all results in an upstream, and of the runs after them."""
    upstream = folder / "upstream"
    timed(folder, program, "run", "scenes.yaml", "--cache", cache)
    timed(folder, program, "cache", "push", "--cache", cache, "--upstream", upstream)
    first, second = [], []
    for round in range(rounds):
        run = (program, "run", "scenes.yaml", "--cache", folder / f"warm-{round}", "--upstream", upstream)
        for times in (first, second):
            taken, said = timed(folder, *run)
            assert "nothing to do" in said, said
            times.append(taken)
    return first, second


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("--actions", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--executors")
    parser.add_argument("--slurm", action="store_true")
    parser.add_argument("--hyperqueue", metavar="PYTHON")
    parser.add_argument("--snakemake", type=pathlib.Path)
    options = parser.parse_args()
    options.program = options.program.resolve()
    there = ["threads", "process", "command"]
    there += ["slurm"] if options.slurm or shutil.which("sinfo") and "SLURM_CONF" in os.environ else []
    there += ["hyperqueue"] if options.hyperqueue or shutil.which("hq") else []
    there += ["snakemake"] if options.snakemake else []
    there += ["snakemake-slurm"] if options.snakemake and "slurm" in there else []
    executors = options.executors.split(",") if options.executors else there
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        folder = pathlib.Path(folder)
        os.environ["PATH"] = f"{folder}/bin:{os.environ['PATH']}"
        if options.slurm:
            stack.enter_context(slurm(folder))
        if options.hyperqueue:
            stack.enter_context(hyperqueue(folder, options.hyperqueue))
        measure(options, executors, folder)


def measure(options, executors, folder):
    (folder / "short.yaml").write_text(PIPELINE)
    loop = f"for n in $(seq {options.actions}); do mkdir out/numbers/$n; echo $n > out/numbers/$n/n; done\n"
    (folder / "numbers.sh").write_text(loop)
    (folder / "Snakefile").write_text(SNAKEFILE.format(options.actions))
    (folder / "numbers").mkdir()
    for n in range(options.actions):
        (folder / f"numbers/{n + 1}").write_text(f"{n + 1}\n")
    base = None
    for executor in executors:
        taken = []
        # The first round reads files from the disk.
        for round in range(options.rounds + 1):
            taken.append(seconds(options, executor, folder, folder / f"{executor}-{round}"))
        taken = taken[1:]
        middle = statistics.median(taken)
        base = middle if base is None else base
        per_action = (middle - base) / options.actions * 1000
        spread = f"({min(taken):.2f} to {max(taken):.2f})"
        print(f"{executor:16} {middle:7.2f} s {spread:18} {per_action:+8.1f} ms per action", flush=True)
    (folder / "scenes.yaml").write_text(SCENES.format(options.actions))
    first, second = warm(options.program, folder, folder / "scenes", options.rounds)
    for name, taken in (("all in the upstream", first), ("again", second)):
        print(f"{name:20} {statistics.median(taken):.2f} s ({min(taken):.2f} to {max(taken):.2f})")


main()
