#!/usr/bin/env python3
"""Runs test programs and says what takes the time.

As cargo's runner, `timed.py PROGRAM ARGUMENTS...` runs a test program, passes on what it writes, and appends one line
of JSON to the file that TAUFLOW_TIMES names: seconds of the program and of each of its tests, skips, and long parts.
`timed.py --summary FILE` prints these lines as tables. Wall seconds depend on what runs beside it; CPU seconds hardly.
"""

import json
import os
import re
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path

# Far more than any test program takes. One that hangs must leave the others their time.
LIMIT_S = 1800

TEST = re.compile(r"^test (\S+)(?: - should panic)? \.\.\. .*?<([0-9.]+)s>$")


def program_of(path: str) -> str:
    """`package/program` of `target/release/deps/program-0123456789abcdef`, run in its package's folder."""
    name = re.sub(r"-[0-9a-f]{16}$", "", Path(path).name)
    return f"{Path.cwd().name}/{name}"


def run(command: list[str]) -> int:
    """Runs a program; writes down what a test program took."""
    to = os.environ.get("TAUFLOW_TIMES")
    if not to or Path(command[0]).parent.name != "deps":
        return subprocess.call(command)
    # Times of single tests are an unstable option of the test harness, which this variable allows on any toolchain.
    environment = {**os.environ, "RUSTC_BOOTSTRAP": "1"}
    start = time.monotonic()
    timed = [*command, "-Zunstable-options", "--report-time"]
    child = subprocess.Popen(timed, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    tests: list[tuple[str, float]] = []
    notes: list[str] = []

    def follow(pipe, out, see) -> None:
        for line in iter(pipe.readline, b""):
            out.write(line)
            out.flush()
            see(line.decode(errors="replace").rstrip("\n"))

    def see_test(line: str) -> None:
        if found := TEST.match(line):
            tests.append((found[1], float(found[2])))

    def see_note(line: str) -> None:
        if found := re.search(r"\b(skipped|part): .*", line):
            notes.append(found[0])

    threads = [
        threading.Thread(target=follow, args=(child.stdout, sys.stdout.buffer, see_test), daemon=True),
        threading.Thread(target=follow, args=(child.stderr, sys.stderr.buffer, see_note), daemon=True),
    ]
    for thread in threads:
        thread.start()
    def stop() -> None:
        note = f"part: {program_of(command[0])} was killed after {LIMIT_S} s"
        print(note, file=sys.stderr, flush=True)
        notes.append(note)
        child.kill()

    limit = threading.Timer(LIMIT_S, stop)
    limit.daemon = True
    limit.start()
    # The program's children count, as far as it waited for them.
    _, status, used = os.wait4(child.pid, 0)
    limit.cancel()
    # A process that the program left behind may hold the pipes open, and must not hold up the other programs.
    for thread in threads:
        thread.join(timeout=10)
    row = {
        "program": program_of(command[0]),
        "wall_s": round(time.monotonic() - start, 2),
        "cpu_s": round(used.ru_utime + used.ru_stime, 2),
        "tests": tests,
        "notes": notes,
    }
    with open(to, "a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")
    code = os.waitstatus_to_exitcode(status)
    return code if code >= 0 else 128 - code


def summary(path: str) -> None:
    """Prints what was skipped, the slowest tests, and what the programs took: the costliest last, next to the end."""
    rows = [json.loads(line) for line in Path(path).read_text(encoding="utf-8").splitlines()]
    for title in ["skipped", "part"]:
        notes = Counter(
            f"{row['program']} {note}" for row in rows for note in row["notes"] if note.startswith(title)
        )
        print(f"{sum(notes.values())} notes: {title}" if notes else f"no notes: {title}")
        for note, count in notes.items():
            print(f"  {note}" + (f" ({count} times)" if count > 1 else ""))
        print()
    tests = [(seconds, row["program"], name) for row in rows for name, seconds in row["tests"]]
    print(f"{'wall s':>8}  slowest tests")
    for seconds, program, name in sorted(tests)[-30:]:
        print(f"{seconds:8.1f}  {program} {name}")
    print(f"\n{'wall s':>8} {'CPU s':>8}  test program")
    for row in sorted(rows, key=lambda row: row["cpu_s"]):
        print(f"{row['wall_s']:8.1f} {row['cpu_s']:8.1f}  {row['program']} ({len(row['tests'])} tests)")
    print(f"{sum(r['wall_s'] for r in rows):8.1f} {sum(r['cpu_s'] for r in rows):8.1f}  together")


if __name__ == "__main__":
    if len(sys.argv) == 3 and sys.argv[1] == "--summary":
        summary(sys.argv[2])
    else:
        sys.exit(run(sys.argv[1:]))
