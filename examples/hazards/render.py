"""Runs a renderer for the node kind `external_renderer`, and accepts that it fails.

python3 render.py once SCENE COUNTS SEED FOLDER PROGRAM [ARGUMENT..]     # the program writes all images by itself
python3 render.py each SCENE COUNTS SEED FOLDER PROGRAM [ARGUMENT..]     # the program writes one image per call

With `each`, the program runs once per sample count. In its arguments, @scene is the path of a copy of scene.xml, @count
the number of samples, @seed a number that is different for each image, and @image the file to write. The copy names the
seed in a comment: programs that derive their random numbers from the file draw others for each image. If the program
fails, or leaves an image out, all images of the scene get -1 in each pixel, which examples/hazards/judge.py reports as
a failure of the program. The error of the program is printed.
"""

import pathlib
import re
import struct
import subprocess
import sys


def exr(width, height, value):
    """The bytes of an OpenEXR file without compression, one value in all channels."""

    def attribute(name, kind, content):
        return f"{name}\0{kind}\0".encode() + struct.pack("<i", len(content)) + content

    channels = b"".join(letter + b"\0" + struct.pack("<iiii", 2, 0, 1, 1) for letter in (b"B", b"G", b"R")) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = b"\x76\x2f\x31\x01\x02\0\0\0" + b"".join(
        (
            attribute("channels", "chlist", channels),
            attribute("compression", "compression", b"\0"),
            attribute("dataWindow", "box2i", window),
            attribute("displayWindow", "box2i", window),
            attribute("lineOrder", "lineOrder", b"\0"),
            attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
            attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
            attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
            b"\0",
        )
    )
    line = struct.pack(f"<{3 * width}f", *[value] * (3 * width))
    first = len(header) + 8 * height
    offsets = b"".join(struct.pack("<Q", first + y * (8 + len(line))) for y in range(height))
    return header + offsets + b"".join(struct.pack("<ii", y, len(line)) + line for y in range(height))


def main():
    how, scene, counts, seed, folder, *program = sys.argv[1:]
    folder, counts, told, text = pathlib.Path(folder), counts.split(","), "", pathlib.Path(scene).read_text()
    if how == "once":
        commands = [program]
    elif how == "each":
        commands = []
        for number, count in enumerate(counts):
            number = (int(seed) + 1009 * number) % 2**31
            copy = pathlib.Path(scene).with_name(f"scene-{count}.xml")
            copy.write_text(f"{text}<!-- random numbers: {number} -->\n")
            own = {"@scene": str(copy), "@count": count, "@seed": str(number), "@image": str(folder / f"{count}.exr")}
            commands.append([re.sub("@[a-z]+", lambda found: own.get(found[0], found[0]), word) for word in program])
    else:
        sys.exit(f"render.py: `{how}` is neither `once` nor `each`")
    for command in commands:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace")
        if done.returncode:
            told = f"{command[0]} failed with {done.returncode}: {done.stderr[-2000:]}"
            break
    missing = [count for count in counts if not (folder / f"{count}.exr").is_file()]
    if told or missing:
        print(told or f"{program[0]} left no image of {', '.join(missing)} samples", file=sys.stderr)
        width, height = (int(re.search(f'name="{side}" value="([0-9]+)"', text)[1]) for side in ("width", "height"))
        for count in counts:
            (folder / f"{count}.exr").write_bytes(exr(width, height, -1.0))


if __name__ == "__main__":
    main()
