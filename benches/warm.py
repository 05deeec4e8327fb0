#!/usr/bin/env python3
"""Time, requests and bytes of a run on a second machine that finds all results in S3.

    python3 benches/warm.py PROGRAM MOTO [--scenes 300000] [--cache CACHE PIPELINE [--target NODE]...]

MOTO is a Python with the package moto and its server, which serves S3 on this machine. By default, the script generates
scenes, one small action each, on machine A, and pushes them. Machine B has an empty cache and another /etc/machine-id,
if file systems can be mounted. It runs the same pipeline, then once more, and once more after a change of one scene.
--cache uses the results of PIPELINE in CACHE instead, which is not written.
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
    parser.add_argument("--scenes", type=int, default=300_000)
    parser.add_argument("--cache", nargs=2, metavar=("CACHE", "PIPELINE"))
    parser.add_argument("--target", action="append", default=[])
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        process, url = server(options.moto, folder)
        try:
            measure(options, folder, url)
        finally:
            process.terminate()
            process.wait()


def measure(options, folder, url):
    program = options.program.resolve()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("AWS_")}
    environment |= {"AWS_ENDPOINT_URL": url, "AWS_ALLOW_HTTP": "true", "AWS_REGION": "us-east-1"}
    environment |= {"AWS_ACCESS_KEY_ID": "id", "AWS_SECRET_ACCESS_KEY": "secret"}
    at_b = another_machine(folder)
    print("machine B:", "another machine-id" if at_b else "the same machine-id")

    def tauflow(what, *words, before=()):
        begun = time.monotonic()
        words = [*before, program, *words]
        said = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
        taken = time.monotonic() - begun
        assert said.returncode == 0, said.stderr
        traffic = re.findall(r"^upstream: .*$", said.stderr, re.M)
        done = re.findall(r"^(?:nothing to do.*|.* ran, .*|pushed .*|.* left out.*)$", said.stderr + said.stdout, re.M)
        print(f"{what:28} {taken:7.2f} s  {'; '.join(done)}")
        for line in traffic:
            print(f"{'':28}            {line}")

    upstream = ["--upstream", "s3://lab/results"]
    if options.cache:
        cache, pipeline = options.cache[0], pathlib.Path(options.cache[1]).resolve()
    else:
        cache, pipeline = folder / "a", folder / "scenes.yaml"
        pipeline.write_text(SCENES.format(options.scenes))
        tauflow("machine A", "run", pipeline, "--cache", cache, "--upstream", "")
    tauflow("machine A pushes", "cache", "push", pipeline, "--cache", cache, *upstream)
    targets = [word for target in options.target for word in ("--target", target)]
    run = ["run", pipeline, *targets, "--cache", folder / "b", *upstream]
    tauflow("machine B", *run, before=at_b)
    tauflow("machine B again", *run, before=at_b)
    if not options.cache:
        pipeline.write_text(SCENES.format(options.scenes + 1))
        tauflow("machine B, one more scene", *run, before=at_b)


main()
