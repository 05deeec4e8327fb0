#!/usr/bin/env python3
"""Time, requests and bytes of a run on a second machine that finds all results in S3.

    python3 benches/warm.py PROGRAM MOTO [--scenes 10000]
    python3 benches/warm.py PROGRAM MOTO --pipeline FILE [--profile NAME] [--cache CACHE] [--edit NODE.PARAM=VALUE]

MOTO is a Python with the package moto and its server, which serves S3 on this machine. Machine A runs a pipeline and
pushes all results; --cache names a cache that already has them. By default the pipeline generates scenes, one small
action each. Machine B has an empty cache and another /etc/machine-id, if file systems can be mounted.

B runs three parts, each with an empty cache: all outputs that have the same bits on every machine, by the lock file of
A; the whole pipeline with the measurements of A; and, with --measure, the whole pipeline with measurements of its own.
Each line tells how many actions ran. The first part is repeated with the cache that it left, and after an edit: one
more scene of the generated ones, or --edit.
"""

import argparse
import os
import pathlib
import re
import socket
import subprocess
import tempfile
import time
import urllib.request

SCENES = """\
pipeline: scenes
seed: 1
nodes:
  scenes:
    kind: scene_generation
    params: {{ pool: {} }}
"""


def server(python, folder):
    """Starts moto's server, and makes a bucket."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = open(folder / "moto.log", "w")
    words = [python, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(words, stdout=log, stderr=log)
    url = f"http://127.0.0.1:{port}"
    for _ in range(200):
        try:
            urllib.request.urlopen(urllib.request.Request(f"{url}/lab", method="PUT")).read()
            return process, url
        except OSError:
            time.sleep(0.1)
    raise SystemExit("moto does not answer")


def another_machine(folder):
    """Words before a command that give it another machine's identity; none if that is not possible."""
    identity = folder / "machine-id"
    identity.write_text("0123456789abcdef0123456789abcdef\n")
    words = ["unshare", "-m", "sh", "-c", 'mount --bind "$0" /etc/machine-id && exec "$@"', str(identity)]
    tried = subprocess.run([*words, "true"], capture_output=True)
    return words if tried.returncode == 0 else []


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("moto")
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--pipeline", type=pathlib.Path)
    parser.add_argument("--profile")
    parser.add_argument("--cache", type=pathlib.Path)
    parser.add_argument("--edit", metavar="NODE.PARAM=VALUE")
    parser.add_argument("--measure", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        process, url = server(options.moto, folder)
        try:
            Machines(options, folder, url).measure()
        finally:
            process.terminate()
            process.wait()


class Machines:
    """Machine A, machine B, and the upstream between them."""

    def __init__(self, options, folder, url):
        self.options, self.folder = options, folder
        self.program = options.program.resolve()
        self.environment = {name: value for name, value in os.environ.items() if not name.startswith("AWS_")}
        self.environment |= {"AWS_ENDPOINT_URL": url, "AWS_ALLOW_HTTP": "true", "AWS_REGION": "us-east-1"}
        self.environment |= {"AWS_ACCESS_KEY_ID": "id", "AWS_SECRET_ACCESS_KEY": "secret"}
        self.at_b = another_machine(folder)
        self.upstream = ["--upstream", "s3://lab/results"]
        self.profile = ["--profile", options.profile] if options.profile else []
        self.pipeline = folder / (options.pipeline.name if options.pipeline else "scenes.yaml")
        edit = options.edit or (None if options.pipeline else f"scenes.pool={options.scenes + 1}")
        self.edit = ["--set", edit] if edit else None
        if options.pipeline:
            self.pipeline.write_text(options.pipeline.read_text())
        else:
            self.pipeline.write_text(SCENES.format(options.scenes))
        print("machine B:", "another machine-id" if self.at_b else "the same machine-id")

    def tauflow(self, what, *words, before=()):
        begun = time.monotonic()
        words = [*before, self.program, *words]
        said = subprocess.run(words, cwd=self.folder, env=self.environment, capture_output=True, text=True)
        taken = time.monotonic() - begun
        assert said.returncode == 0, said.stderr
        told = said.stderr + said.stdout
        done = re.findall(r"^(?:nothing to do.*|.* ran, .*|pushed .*|.* left out.*|measurements: .*)$", told, re.M)
        print(f"{what:34} {taken:7.2f} s  {'; '.join(done)}", flush=True)
        for line in re.findall(r"^upstream: .*$", said.stderr, re.M):
            print(f"{'':34}            {line}", flush=True)

    def on_b(self, what, cache, *words):
        run = ["run", self.pipeline, *self.profile, *words, "--cache", self.folder / cache, *self.upstream]
        self.tauflow(f"machine B, {what}", *run, before=self.at_b)

    def measure(self):
        options = self.options
        cache = (options.cache or self.folder / "a").resolve()
        on_a = [self.pipeline, *self.profile, "--cache", cache]
        self.tauflow("machine A", "run", *on_a, "--upstream", "", "--update-lock")
        self.tauflow("machine A pushes", "cache", "push", *on_a, "--all", *self.upstream)
        (lock,) = self.folder.glob("*.lock")
        part = lock.read_text().split("left_out:")[0]
        found = re.findall(r'^  "?(\w+)(?:\[.*\])?\.(\w+)"?: ', part, re.M)
        bitwise = sorted({".".join(output) for output in found})
        print(f"{len(bitwise)} outputs have the same bits on every machine")
        targets = [word for output in bitwise for word in ("--target", output)]
        self.on_b("bitwise outputs", "b", *targets)
        self.on_b("again", "b", *targets)
        if self.edit:
            self.on_b("after an edit", "b", *targets, *self.edit)
        if options.pipeline:
            self.on_b("all, A's measurements", "accepting", "--accept-measured")
        if options.measure:
            self.on_b("all, measured again", "measuring")


main()
