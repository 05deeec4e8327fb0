"""Compares images of pipelines/hazards.yaml with the exact radiance; a program of the node kind `command`.

python3 judge.py EXACT.json

A renderer *holds* if its error is certainly within the demand, *fails* if it is certainly beyond, and otherwise the
samples *cannot say*. Each scene has several independent images. Without noise, each pixel of each image must be within
the demand. Otherwise the mean of the images has a confidence interval by Student's distribution; all intervals of the
table together miss a true value with a probability of 1% (Sidak). An interval within the demand holds, and one that
does not touch it fails. The rungs of a ladder share samples: the differences of neighbouring rungs are independent.
"""

import array
import collections
import csv
import json
import math
import pathlib
import statistics
import sys

MISSED = 0.01


def images(folder):
    """The method's name, its images by sample count, and a note on missing ones."""
    meta = json.loads((folder / "meta.json").read_text())
    if "counts" in meta:
        if meta["rejected"]:
            return "tauflow", {}, f"{meta['rejected']} contributions are not finite"
        return "tauflow", {count: pfm(folder / f"spp-{count:06}.pfm") for count in meta["counts"]}, None
    found = {}
    for of in meta["images"]:
        name = "{method}-{from_spp}-to-{to_spp}-nfe-{nfe}.pfm".format(**of)
        found[of["to_spp"]] = pfm(folder / name)
    return meta["images"][0]["method"] if found else None, found, meta.get("note")


def pfm(path):
    """All numbers of an image."""
    with path.open("rb") as file:
        head = [file.readline() for _ in range(3)]
        numbers = array.array("f", file.read())
    if (float(head[2]) < 0) != (sys.byteorder == "little"):
        numbers.byteswap()
    return numbers


def inside(t, freedom):
    """Probability that Student's t is between -t and t."""
    angle = math.atan(t / math.sqrt(freedom))
    sine, cosine = math.sin(angle), math.cos(angle)
    odd = freedom % 2
    term, total = (cosine if odd else 1.0), 0.0
    for k in range(1 + odd, freedom, 2):
        total += term
        term *= k / (k + 1) * cosine * cosine
    return 2 / math.pi * (angle + sine * total) if odd else sine * total


def quantile(missed, freedom):
    """The t that is exceeded, to either side, with this probability."""
    low, high = 0.0, 1e9
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if inside(middle, freedom) < 1 - missed else (low, middle)
    return high


def batches(found, nested):
    """Means of independent images."""
    counts = sorted(found)
    means = [statistics.fmean(found[count]) for count in counts]
    if not nested:
        return means
    pairs = zip([0, *counts], [0.0, *means], counts, means)
    return [(n * mean - before * old) / (n - before) for before, old, n, mean in pairs]


def verdict(answer, found, nested, note, missed):
    """The verdict, the value, the half width of its interval, and a remark."""
    exact, allowed = answer["exact"], answer["demand"] * answer["exact"]
    numbers = [number for image in found.values() for number in image]
    if note or not numbers:
        return "fails", None, None, note or "no image"
    if all(number == -1 for number in numbers):
        return "fails", None, None, "the program failed"
    if not all(map(math.isfinite, numbers)):
        return "fails", None, None, f"{sum(not math.isfinite(n) for n in numbers)} values are not finite"
    last = found[max(found)]
    value = statistics.fmean(last) if nested else statistics.fmean(batches(found, False))
    if not answer["noise"]:
        off = max(abs(number - exact) for number in numbers)
        remark = f"a pixel is {max(numbers, key=lambda number: abs(number - exact)):.6g}" if off > allowed else ""
        return "fails" if off > allowed else "holds", value, 0.0, remark
    means = batches(found, nested)
    half = quantile(missed, len(means) - 1) * statistics.stdev(means) / math.sqrt(len(means))
    off = abs(value - exact)
    if off + half <= allowed:
        return "holds", value, half, ""
    return ("fails" if off - half > allowed else "cannot say"), value, half, ""


def cell(word, value, half, remark):
    """Of the Markdown table."""
    told = "" if value is None else f" {value:.6g}" + (f" ± {half:.1g}" if half else "")
    word = word if word == "holds" else f"**{word}**"
    return f"{word}{told}{': ' + remark if remark else ''}"


def main():
    answers = json.loads(pathlib.Path(sys.argv[1]).read_text())
    cases, notes = {}, []
    for port in sorted(pathlib.Path("in").iterdir()):
        for folder in sorted(port.iterdir()):
            # The number of the scene in its stratum.
            name = folder.name.rsplit("-", 1)[0]
            if name not in answers:
                sys.exit(f"the scene `{folder.name}` has no exact value in {sys.argv[1]}; run scenes.py")
            method, found, note = images(folder)
            if method is None:
                notes += [] if note in notes else [note]
                continue
            if not note and len(found) < 2:
                sys.exit(f"`{method}` has one image of `{name}`; ask for several sample counts")
            cases[name, method] = found, method == "tauflow", note
    methods = sorted({method for _, method in cases}, key=lambda method: (not method.startswith("tauflow"), method))
    names = [name for name in answers if any((name, method) in cases for method in methods)]
    tests = sum(answers[name]["noise"] for name, _ in cases)
    missed = 1 - (1 - MISSED) ** (1 / max(tests, 1))
    rows = {key: verdict(answers[key[0]], *case, missed) for key, case in cases.items()}

    out = pathlib.Path("out/table/all")
    out.mkdir(parents=True)
    lines = ["| hazard | exact | demand | " + " | ".join(methods) + " |", "|---|---:|---:|" + "---|" * len(methods)]
    for name in names:
        answer = answers[name]
        cells = [cell(*rows[name, method]) if (name, method) in rows else "" for method in methods]
        demand = f"{answer['demand']:.2g}" if answer["exact"] else "exact"
        lines.append(f"| {answer['about']} | {answer['exact']:.6g} | {demand} | " + " | ".join(cells) + " |")
    lines.append("")
    for method in methods:
        count = collections.Counter(row[0] for (_, of), row in rows.items() if of == method)
        lines.append(f"- {method}: {count['holds']} hold, {count['fails']} fail, {count['cannot say']} cannot say")
    lines += [f"- left out: {note}" for note in notes]
    (out / "hazards.md").write_text("\n".join(lines) + "\n")
    with (out / "hazards.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["hazard", "method", "verdict", "value", "half_width", "exact", "demand", "remark"])
        for name in names:
            for method in (method for method in methods if (name, method) in rows):
                word, value, half, remark = rows[name, method]
                answer = answers[name]
                table.writerow([name, method, word, value, half, answer["exact"], answer["demand"], remark])


if __name__ == "__main__":
    main()
