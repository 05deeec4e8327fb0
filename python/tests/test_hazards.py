"""`pipelines/hazards.yaml`: verdicts on a renderer that is right, on one that is wrong, and on one that fails."""

import csv
import json
import pathlib
import shutil
import subprocess
import sys

import pytest

import tauflow

ROOT = pathlib.Path(__file__).resolve().parents[2]
HAZARDS = ROOT / "examples/hazards"
# With noise and without, and one at which the path tracer fails: its triangles are too thin for their distance.
SCENES = ["sun-1e5", "lamp-away", "cube-2", "slab-gap-behind", "slivers-4"]
TWICE = "--exposure, '2'"
EACH = "python3, examples/hazards/render.py, each, '{scene}', '{counts}', '{seed}', '{folder}'"

sys.path.insert(0, str(HAZARDS))
judge = __import__("judge")


def judged(folder, *sets):
    """Rows of hazards.csv by hazard and method, and hazards.md."""
    scenes = ", ".join(f"{{path: examples/hazards/scenes/{name}.xml, stratum: {name}}}" for name in SCENES)
    sets = [
        f"scenes.scenes=[{scenes}]",
        f"values.tauflow={tauflow.program()}",
        "values.python=no-such-python",
        f"values.counts={list(range(256, 272))}",
        f"values.rungs={[256 * k for k in range(1, 17)]}",
        *sets,
    ]
    where = ["--cache", folder / "cache", *(word for text in sets for word in ("--set", text))]

    def run(*words):
        done = subprocess.run([tauflow.program(), *map(str, words)], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    run("run", "pipelines/hazards.yaml", "--out", folder / "out", *where)
    run("export", "pipelines/hazards.yaml", "table", "-o", folder / "table", *where)
    with (folder / "table/all/hazards.csv").open(newline="") as file:
        rows = {(row["hazard"], row["method"]): row for row in csv.DictReader(file)}
    return rows, (folder / "table/all/hazards.md").read_text()


def test_renderers_hold_or_fail_where_they_do(tmp_path):
    rows, page = judged(
        tmp_path,
        "program.method=bright",
        "program.version=[]",
        f"program.command=[{EACH}, {tauflow.program()}, render, '@scene', --spp, '@count', -o, '@image', {TWICE}]",
        "other.method=broken",
        "other.version=[]",
        f"other.command=[{EACH}, python3, -c, 'raise SystemExit(3)']",
    )
    assert len(rows) == 4 * len(SCENES), page
    for (hazard, method), row in rows.items():
        if method == "broken":
            assert (row["verdict"], row["remark"]) == ("fails", "the program failed"), row
        elif hazard == "slivers-4":
            assert row["verdict"] == "fails" and float(row["value"]) == 0, row
        elif method == "bright" and hazard != "lamp-away":
            assert row["verdict"] == "fails", row
        else:
            assert row["verdict"] == "holds", row
    # As a program, the path tracer renders other samples of the same expectation.
    methods = ("tauflow", "tauflow-render", "bright")
    value = {method: float(rows["cube-2", method]["value"]) for method in methods}
    assert value["tauflow"] != value["tauflow-render"]
    assert abs(value["bright"] / value["tauflow-render"] - 2) < 0.02
    assert float(rows["cube-2", "tauflow-render"]["half_width"]) > 0, "images are independent"


def test_missing_programs_are_left_out_with_a_note(tmp_path):
    rows, page = judged(tmp_path)
    assert {method for _, method in rows} == {"tauflow", "tauflow-render"}
    assert "- left out: mitsuba-scalar_rgb: " in page and "no-such-python" in page


def test_the_scenes_are_those_of_the_script(tmp_path):
    shutil.copy(HAZARDS / "scenes.py", tmp_path)
    subprocess.run([sys.executable, tmp_path / "scenes.py"], check=True)
    names = sorted(path.name for path in (tmp_path / "scenes").iterdir())
    assert names == sorted(path.name for path in (HAZARDS / "scenes").iterdir())
    for name in names:
        made, kept = ((folder / "scenes" / name).read_bytes() for folder in (tmp_path, HAZARDS))
        assert made == kept, f"{name} is not what scenes.py writes; run it"
    command = [sys.executable, tmp_path / "scenes.py", "--list"]
    listed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert listed in (ROOT / "pipelines/hazards.yaml").read_text(), "hazards.yaml lists other scenes than scenes.py"
    assert len(json.loads((HAZARDS / "scenes/exact.json").read_text())) == listed.count("\n")


@pytest.mark.parametrize(("missed", "freedom", "t"), [(0.05, 15, 2.1314), (0.05, 10, 2.2281), (0.01, 1, 63.657)])
def test_students_quantiles(missed, freedom, t):
    assert judge.quantile(missed, freedom) == pytest.approx(t, rel=1e-4)


def test_verdicts():
    answer = {"exact": 2.0, "demand": 0.01, "noise": True}
    images = {count: [2.0 + 0.001 * (-1) ** count] * 12 for count in range(64, 80)}

    def word(found, answer=answer, nested=False, note=None):
        return judge.verdict(answer, found, nested, note, 1e-4)[0]

    assert word(images) == "holds"
    assert word({count: [v + 0.1 for v in image] for count, image in images.items()}) == "fails"
    noisy = {count: [2.0 + 0.1 * (-1) ** count] * 12 for count in range(64, 80)}
    assert word(noisy) == "cannot say"
    assert word({**images, 64: [float("nan")] * 12}) == "fails"
    assert word(dict.fromkeys(images, [-1.0] * 12)) == "fails"
    assert word(images, note="3 contributions are not finite") == "fails"
    # Without noise, one pixel decides.
    exact = {**answer, "noise": False, "demand": 1e-6}
    assert word(dict.fromkeys(images, [2.0] * 12), exact) == "holds"
    assert word({**dict.fromkeys(images, [2.0] * 12), 64: [2.0] * 11 + [2.001]}, exact) == "fails"
    # Rungs of a ladder share samples: means of its parts are 1, 3, 1, 3 ..
    nested = {64 * k: [2.0 - (k % 2) / k] * 12 for k in range(1, 9)}
    assert judge.batches(nested, True) == pytest.approx([1, 3] * 4)
