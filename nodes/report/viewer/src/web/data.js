// Data of the page: the index, and the images of a scene, which are read when they are first looked at.

const index = JSON.parse(document.getElementById("index").textContent);
const arrived = new Map();

/// Scripts in the folder beside the page call this with their content.
window.tauflowData = (name, content) => arrived.set(name, content);

/// The content of a part: from the page itself, or by a script from the folder beside it.
function part(name) {
  if (arrived.has(name)) return Promise.resolve(arrived.get(name));
  const inline = document.getElementById("d-" + name);
  if (inline) return Promise.resolve().then(() => JSON.parse(inline.textContent));
  return new Promise((fine, bad) => {
    const file = `${index.folder}/${name}.js`;
    const script = document.createElement("script");
    const failed = (why) => bad(new Error(`${file} ${why}; make this page again: ${index.command}`));
    script.src = file.split("/").map(encodeURIComponent).join("/");
    script.onload = () => {
      script.remove();
      if (!arrived.has(name)) return failed("is damaged");
      const content = arrived.get(name);
      arrived.delete(name);
      fine(content);
    };
    script.onerror = () => { script.remove(); failed("is missing"); };
    document.head.append(script);
  });
}

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/// Half floats [height, width, channels] of an image. Its bytes are planes of differences (see `half.rs`).
async function halves(packed, what) {
  const { w, h, c } = packed, count = w * h * c;
  let bytes;
  try {
    bytes = await inflate(packed.d);
  } catch {
    bytes = new Uint8Array(0);
  }
  if (bytes.length !== 2 * count) throw new Error(`${what}: its data is damaged; make this page again: ${index.command}`);
  const out = new Uint16Array(count);
  for (let plane = 0, at = 0; plane < c; plane++) {
    for (let y = 0; y < h; y++) {
      let last = y ? out[(y - 1) * w * c + plane] : 0;
      for (let x = 0; x < w; x++, at++) {
        last = (last + (bytes[at] << 8 | bytes[count + at])) & 0xffff;
        out[(y * w + x) * c + plane] = last;
      }
    }
  }
  return out;
}

const HALF = (() => {
  const table = new Float32Array(65536);
  for (let bits = 0; bits < 65536; bits++) {
    const sign = bits & 0x8000 ? -1 : 1, exponent = bits >> 10 & 31, mantissa = bits & 1023;
    if (exponent === 31) table[bits] = mantissa ? NaN : sign * Infinity;
    else table[bits] = sign * (exponent ? (1 + mantissa / 1024) * 2 ** (exponent - 15) : mantissa * 2 ** -24);
  }
  return table;
})();

/// The images of a scene by frame. Keeps the last few scenes.
const kept = new Map();
function sceneData(number) {
  let data = kept.get(number);
  if (!data) {
    data = part(`s${String(number).padStart(6, "0")}`).then((content) => ({ number, packed: content.images, ready: new Map() }));
    data.catch(() => kept.delete(number));
  }
  kept.delete(number);
  kept.set(number, data);
  while (kept.size > 4) kept.delete(kept.keys().next().value);
  return data;
}

/// One image of a scene: {w, h, c, half, error, clipped}, or null if the scene has none for this frame.
function imageOf(data, frame) {
  const packed = data.packed[frame];
  if (!packed) return Promise.resolve(null);
  if (!data.ready.has(frame)) {
    const what = `${index.scenes[data.number].key}, ${frameName(frame)}`;
    data.ready.set(frame, halves(packed, what).then((half) =>
      ({ w: packed.w, h: packed.h, c: packed.c, half, error: packed.e, clipped: packed.x, frame, id: `${data.number}/${frame}` })));
  }
  return data.ready.get(frame);
}

function frameName(frame) {
  const { track, label } = index.frames[frame];
  return `${index.tracks[track].name}, ${label}`;
}

/// Channel `k` of pixel `i`; images of one channel are grey.
const valueOf = (image, i, k) => HALF[image.half[i * image.c + Math.min(k, image.c - 1)]];

/// The same in linear light: display values without their curve.
const lightOf = (image, i, k) => kindOf(image) === 4 ? unsrgb(clip(valueOf(image, i, k))) : valueOf(image, i, k);

/// Luminance of pixel `i` (Rec. 709).
const luminance = (image, i) => 0.2126 * lightOf(image, i, 0) + 0.7152 * lightOf(image, i, 1) + 0.0722 * lightOf(image, i, 2);
