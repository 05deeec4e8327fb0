#!/usr/bin/env python3
"""Time per action of the executors, for a node of short programs.

    python3 benches/executors.py PROGRAM [--actions 200] [--rounds 3] [--executors threads,process,command,slurm]

It prints the median wall time of a run from an empty cache, and the time per action beyond the first executor. Then it
generates as many scenes, pushes them to an upstream, and prints the time of a run with an empty cache that finds all of
them there, and of a second run with this cache. Slurm must run, if it is among the executors.
"""

import argparse
import pathlib
import statistics
import subprocess
import tempfile
import time

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


def timed(folder, *words):
    begun = time.monotonic()
    said = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    return time.monotonic() - begun, said.stderr


def seconds(program, executor, folder, cache):
    options = ["--executor", executor, *(SHELL if executor == "command" else [])]
    return timed(folder, program, "run", "short.yaml", "--cache", cache, *options)[0]


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
    parser.add_argument("--executors", default="threads,process,command,slurm")
    options = parser.parse_args()
    executors = options.executors.split(",")
    times = {executor: [] for executor in executors}
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        (folder / "short.yaml").write_text(PIPELINE)
        loop = f"for n in $(seq {options.actions}); do mkdir out/numbers/$n; echo $n > out/numbers/$n/n; done\n"
        (folder / "numbers.sh").write_text(loop)
        for round in range(options.rounds + 1):
            for executor in executors if round % 2 else reversed(executors):
                cache = folder / f"{executor}-{round}"
                taken = seconds(options.program.resolve(), executor, folder, cache)
                if round > 0:  # the first reads files from the disk
                    times[executor].append(taken)
        (folder / "scenes.yaml").write_text(SCENES.format(options.actions))
        first, second = warm(options.program.resolve(), folder, folder / "scenes", options.rounds)
    base = statistics.median(times[executors[0]])
    for executor, taken in times.items():
        middle = statistics.median(taken)
        per_action = (middle - base) / options.actions * 1000
        print(f"{executor:10} {middle:7.2f} s ({min(taken):.2f} to {max(taken):.2f}), {per_action:+.1f} ms per action")
    for name, taken in (("all in the upstream", first), ("again", second)):
        print(f"{name:20} {statistics.median(taken):.2f} s ({min(taken):.2f} to {max(taken):.2f})")


main()
