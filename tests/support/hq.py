#!/usr/bin/env python3
"""Speaks as `hq` does, as far as tauflow calls it, over the Python package `hyperqueue`, which has no such program.

hq.py serve CORES                        a server with a worker, until its standard input is closed
hq.py submit --array 0-N [...] -- WORDS  prints the id of the job
hq.py task list ID --output-mode=json    prints the states of its tasks
hq.py job cancel ID

HQ_SERVER_DIR is the server's folder. The package does not tell states of tasks, so tasks write theirs to files there.
"""

import argparse
import json
import os
import pathlib
import shlex
import signal
import sys
import tempfile

from hyperqueue import Client, Job, LocalCluster
from hyperqueue.cluster import WorkerConfig
from hyperqueue.ffi.protocol import ResourceRequest

SERVER = pathlib.Path(os.environ["HQ_SERVER_DIR"])
JOBS = SERVER / "jobs"
# Of the worker that tests start.
CORES = 2


def serve(cores):
    JOBS.mkdir(parents=True)
    with LocalCluster(server_dir=str(SERVER / "server"), worker_config=WorkerConfig(cores=cores)):
        print("ready", flush=True)
        sys.stdin.read()


def submit(arguments):
    parser = argparse.ArgumentParser(prog="hq submit")
    parser.add_argument("--output-mode", choices=["quiet"], required=True)
    parser.add_argument("--name", required=True)
    parser.add_argument("--array", required=True)
    parser.add_argument("--stdout", required=True)
    parser.add_argument("--stderr", choices=["none"], required=True)
    parser.add_argument("--cpus", default="1")
    parser.add_argument("--resource", action="append", default=[])
    parser.add_argument("--time-limit")
    split = arguments.index("--")
    options = parser.parse_args(arguments[:split])
    words = shlex.join(arguments[split + 1 :])
    first, last = map(int, options.array.split("-"))
    folder = pathlib.Path(tempfile.mkdtemp(dir=JOBS))
    asked = [option for option in arguments[:split] if option.startswith(("--cpus=", "--resource=", "--time-limit="))]
    (folder / "options").write_text(" ".join(asked))
    job = Job(default_workdir=os.getcwd(), max_fails=None, name=options.name)
    for task in range(first, last + 1):
        at = shlex.quote(str(folder / str(task)))
        script = (
            f"[ ! -e {at}.cancelled ] || exit 1; {words} & echo $! > {at}.pid; wait $!; code=$?; "
            f"echo $code > {at}.end; exit $code"
        )
        env = {**os.environ, "HQ_TASK_ID": str(task)}
        # Workers of the package have cores, and tell of nothing else.
        resources = ResourceRequest(cpus=CORES if options.cpus == "all" else int(options.cpus))
        out = options.stdout.replace("%{TASK_ID}", str(task))
        job.program(["sh", "-c", script], env=env, stdout=out, stderr=None, cwd=os.getcwd(), resources=resources)
    submitted = Client(SERVER / "server").submit(job)
    (folder / "count").write_text(str(last + 1))
    (JOBS / str(submitted.id)).symlink_to(folder)
    print(submitted.id)


def folder_and_count(job):
    folder = JOBS / job
    return folder, int((folder / "count").read_text())


def state(folder, task):
    if (folder / f"{task}.end").exists():
        code = (folder / f"{task}.end").read_text().strip()
        return "finished" if code == "0" else "failed"
    if (folder / f"{task}.pid").exists():
        return "running"
    return "canceled" if (folder / f"{task}.cancelled").exists() else "waiting"


def main():
    match sys.argv[1:]:
        case ["serve", cores]:
            serve(int(cores))
        case ["submit", *arguments]:
            submit(arguments)
        case ["task", "list", job, "--output-mode=json"]:
            folder, count = folder_and_count(job)
            print(json.dumps({job: [{"id": task, "state": state(folder, task)} for task in range(count)]}))
        case ["job", "cancel", job]:
            folder, count = folder_and_count(job)
            for task in range(count):
                (folder / f"{task}.cancelled").touch()
                if state(folder, task) == "running":
                    os.kill(int((folder / f"{task}.pid").read_text()), signal.SIGTERM)
        case other:
            sys.exit(f"hq: unknown words {other}")


main()
