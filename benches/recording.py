#!/usr/bin/env python3
"""Records an edit and its rerun in a terminal, and writes the recording as an animated SVG.

    python3 benches/recording.py docs/recording.svg

Each command runs in a pseudo-terminal of `script`, which also writes when each line came. The SVG replays them; lines
of progress replace each other, and pauses are cut to half a second. The output itself says how long the runs took. It
needs `tauflow` in target/release, and `script` of util-linux.
"""

import html
import os
import re
import subprocess
import sys
import tempfile
import textwrap

REPOSITORY = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
# The pipeline of the recording: `samplers` with small films, so that it takes seconds.
COMMANDS = [
    "tauflow run samplers.yaml",
    "sed -i 's/rungs: .4, 8, 16, 32, 64./rungs: [4, 8, 16, 32, 64, 128]/' samplers.yaml",
    "tauflow plan samplers.yaml",
    "tauflow run samplers.yaml",
]
COLUMNS, FONT, LINE, PAD = 100, 14, 20, 18
LONGEST = 0.5
# A node with what is done of it, or the time so far.
PROGRESS = re.compile(r"^\w+: \d+/\d+")


def record(command, folder, environment):
    """Lines of a command's output, each with the seconds at which it ended, and the time of all."""
    log, timing = os.path.join(folder, "log"), os.path.join(folder, "timing")
    subprocess.run(
        ["script", "-q", "-e", "-c", command, "--log-out", log, "--log-timing", timing, "--logging-format", "classic"],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stdin=subprocess.DEVNULL,
        check=True,
    )
    data = open(log, "rb").read()
    # The log begins with a line on the session, and ends with another.
    data = data.split(b"\n", 1)[1]
    now, place, lines, rest = 0.0, 0, [], b""
    for row in open(timing):
        delay, count = row.split()
        now, chunk = now + float(delay), data[place : place + int(count)]
        place += int(count)
        rest += chunk
        *whole, rest = rest.split(b"\n")
        lines += [(now, line) for line in whole]
    text = lambda line: re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b"", line).decode().rstrip("\r").split("\r")[-1]
    return [(at, text(line)) for at, line in lines], now


def wrapped(line):
    return [line] if len(line) <= COLUMNS else textwrap.wrap(line, COLUMNS, subsequent_indent="  ")


def main():
    with tempfile.TemporaryDirectory() as folder:
        source = open(os.path.join(REPOSITORY, "pipelines", "samplers.yaml")).read()
        source = source.replace("film: [64, 64]", "film: [32, 32]").replace("pool: 24", "pool: 12")
        source = source.replace("rungs: [1024]", "rungs: [256]")
        open(os.path.join(folder, "samplers.yaml"), "w").write(source)
        path = os.path.join(REPOSITORY, "target", "release") + os.pathsep + os.environ["PATH"]
        environment = {**os.environ, "PATH": path, "TERM": "dumb", "NO_COLOR": "1", "COLUMNS": str(COLUMNS)}
        frames, at = [], 0.0
        for command in COMMANDS:
            frames += [(at, "$ " + part if not i else part) for i, part in enumerate(wrapped(command))]
            lines, took = record(command, folder, environment)
            begin, before, shift = at + 0.8, 0.0, 0.0
            for moment, line in lines:
                shift += max(0.0, moment - before - LONGEST)
                before = moment
                frames += [(begin + moment - shift, part) for part in wrapped(line)]
            at = begin + (before - shift if lines else 0.0) + 1.2
            print(f"{took:6.1f} s  {command}", file=sys.stderr)
    # Each frame with its row: a line of progress shares that of the one before it.
    rows, row = [], -1
    for i, (_, line) in enumerate(frames):
        follows = i > 0 and PROGRESS.match(line) and PROGRESS.match(frames[i - 1][1])
        row += 0 if follows else 1
        rows.append(row)
    height, width = 2 * PAD + LINE * (row + 1), 2 * PAD + int(COLUMNS * FONT * 0.605)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'role="img" aria-label="A terminal: a run, an edit, a plan and the rerun">',
        "<style>text{font:%dpx ui-monospace,SFMono-Regular,Menlo,Consolas,'DejaVu Sans Mono',monospace;fill:#d7dde5;"
        "white-space:pre}.c{fill:#7fd1a0;font-weight:600}@media (prefers-reduced-motion:no-preference){text{opacity:0;"
        "animation:a .01s forwards}.p{animation:b forwards}}@keyframes a{to{opacity:1}}"
        "@keyframes b{from,99%%{opacity:1}to{opacity:0}}.p{opacity:0}</style>" % FONT,
        f'<rect width="{width}" height="{height}" rx="8" fill="#14181f"/>',
    ]
    for i, (moment, line) in enumerate(frames):
        # Progress goes when the next line of its row comes.
        passes = i + 1 < len(frames) and rows[i + 1] == rows[i]
        name = ' class="c"' if line.startswith("$ ") else ' class="p"' if passes else ""
        stays = f";animation-duration:{max(frames[i + 1][0] - moment, 0.01):.2f}s" if passes else ""
        y = PAD + LINE * rows[i] + FONT
        out.append(
            f'<text{name} x="{PAD}" y="{y}" style="animation-delay:{moment:.2f}s{stays}" xml:space="preserve">'
            f"{html.escape(line)}</text>"
        )
    open(sys.argv[1], "w").write("\n".join([*out, "</svg>", ""]))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main()
