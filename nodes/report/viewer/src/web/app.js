// State of the page, and the way from it to the canvas.

const $ = (id) => document.getElementById(id);

/// `a`, `b` are numbers of frames; `x`, `y` the screen position of the image's corner; `scale` screen pixels per image
/// pixel. Screen pixels are those of the display.
const state = {
  scene: 0, a: 0, b: null, mode: "single", swapped: false, ev: 0, tone: 0, channel: 0, measure: "squared", range: 0,
  automatic: true, wipe: 0.5, x: 0, y: 0, scale: 1, fitted: true, probe: null,
};
/// The images that are shown, once they are there, and the error between them.
const now = { a: null, b: null, data: null, error: null, token: 0 };
let canvas = null, timer = 0, asked = false;

/// What the error of A against B is: in the mode of directions, their signed difference.
const measured = () => state.mode === "direction" ? "signed" : state.measure;
const maps = () => state.mode === "error" || state.mode === "direction";
/// The state before a frame, if the scene has it.
const beforeOf = (data, frame) => {
  const before = frame === null ? undefined : index.frames[frame].before;
  return before !== undefined && data.packed[before] ? before : null;
};

/// Whether a frame is what somebody would see, and no feature of it.
const isPicture = (frame) => ["radiance", "display"].includes(index.frames[frame].content);
const kindOf = (image) => image ? { radiance: 0, albedo: 1, normal: 2, variance: 3, display: 4 }[index.frames[image.frame].content] : 0;
const pixelRatio = () => window.devicePixelRatio || 1;
const gain = () => 2 ** state.ev;

function tell(text, bad) {
  $("message").hidden = !text;
  $("message").textContent = text || "";
  $("message").classList.toggle("bad", Boolean(bad));
}

/// Shows another scene with the same frames; where it lacks one, the nearest of its kind.
async function goTo(number) {
  state.scene = number;
  await refresh();
  revealRow();
}

function choose(side, frame) {
  if (side === "b") {
    state.b = frame;
    if (["single", "direction"].includes(state.mode)) state.mode = "wipe";
  } else {
    state.a = frame;
    if (state.mode === "flip") state.swapped = false;
  }
  refresh();
}

/// The frame itself if the scene has it, else another of its track, else the first that the scene has.
function nearest(data, frame) {
  if (frame === null || data.packed[frame]) return frame;
  const has = Object.keys(data.packed).map(Number);
  const kin = has.filter((other) => index.frames[other].track === index.frames[frame].track);
  return kin.length ? kin[kin.length - 1] : has[0] ?? null;
}

/// Reads what the state names, then draws it. Of several calls, the last counts.
async function refresh() {
  const token = ++now.token, scene = state.scene;
  try {
    const data = await sceneData(scene);
    const a = nearest(data, state.a);
    // Features are compared with what is chosen, but not with the reference by themselves.
    const b = state.mode === "direction" ? beforeOf(data, a) : nearest(data, state.b ?? (a !== null && isPicture(a) ? defaultB(data) : null));
    const images = await Promise.all([a, b].map((frame) => frame === null ? null : imageOf(data, frame)));
    if (token !== now.token) return;
    const resized = !now.a || images[0].w !== now.a.w || images[0].h !== now.a.h;
    [now.a, now.b] = images;
    now.data = data;
    tell(!images[0] ? "this scene has no image" : state.mode === "direction" && b === null ? "there is no state before this one" : "");
    if (now.b && (now.b.w !== now.a.w || now.b.h !== now.a.h)) now.b = null;
    if (resized || state.fitted) fit();
    now.error = null;
    measure();
    showPanels();
    redraw();
    remember();
  } catch (error) {
    if (token !== now.token) return;
    // Figures of the scene before must not stand below the name of this one.
    now.a = now.b = now.error = null;
    tell(error.message, true);
    showPanels();
    redraw();
    remember();
  }
}

/// The reference of a scene, if it has one.
function defaultB(data) {
  const { reference } = index.scenes[data.number];
  return reference !== null && data.packed[reference] ? reference : null;
}

/// FLIP takes a while, and is computed only where it is shown.
function measure() {
  if (maps() || state.measure !== "flip") findError();
}

/// The error of A against B by pixel, for statistics, the range of the colours, and FLIP.
function findError() {
  const { a, b } = now;
  if (!a || !b) return;
  const count = a.w * a.h, key = [a.id, b.id, measured(), state.ev, state.tone, state.channel].join(" ");
  if (now.error && now.error.key === key) return;
  let map;
  if (measured() === "flip") {
    const side = (image) => (i) => shown([0, 1, 2].map((k) => lightOf(image, i, k)), gain(), state.tone === 4 ? 0 : state.tone).map(unsrgb);
    map = flipMap(side(a), side(b), a.w, a.h);
    canvas.scalar(map, a.w, a.h);
  } else {
    map = new Float32Array(count);
    for (let i = 0; i < count; i++) map[i] = errorAt(i);
  }
  const sizes = Float32Array.from(map, Math.abs).filter(Number.isFinite).sort();
  const high = sizes.length ? sizes[Math.min(sizes.length - 1, Math.floor(0.99 * sizes.length))] : 0;
  now.error = { key, map, high: high || sizes[sizes.length - 1] || 1 };
  if (state.automatic) state.range = measured() === "flip" ? 1 : Number(now.error.high.toPrecision(2)) || 1;
}

/// Error of pixel `i`, as the shader has it.
function errorAt(i) {
  const a = [0, 1, 2].map((k) => valueOf(now.a, i, k)), b = [0, 1, 2].map((k) => valueOf(now.b, i, k));
  const luma = (v) => 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2];
  const picked = (v) => state.channel === 0 ? v : Array(3).fill(state.channel === 4 ? luma(v) : v[state.channel - 1]);
  const g = gain(), mean = (v) => (v[0] + v[1] + v[2]) / 3, d = a.map((v, k) => (v - b[k]) * g);
  const name = measured();
  if (name === "flip") return now.error ? now.error.map[i] : NaN;
  // A squared difference is picked after it is squared, which is the same but for luminance.
  if (name === "squared") return mean(picked(d.map((v) => v * v)));
  if (name === "absolute") return mean(picked(d).map(Math.abs));
  if (name === "signed") return state.channel === 0 ? luma(d) : picked(d)[0];
  const s = picked(a.map((v, k) => v - b[k])), base = picked(b);
  return mean(s.map((v, k) => v * v / (base[k] * base[k] + 0.01)));
}

function redraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; paint(); });
}

/// Which image a mode shows: 0 A, 1 B, 2 both, 3 their error.
function showing() {
  if (!now.b) return 0;
  if (state.mode === "wipe") return 2;
  if (maps()) return 3;
  return state.swapped ? 1 : 0;
}

function paint() {
  if (!canvas) return;
  const box = $("view"), ratio = pixelRatio();
  const [w, h] = [Math.round(box.clientWidth * ratio), Math.round(box.clientHeight * ratio)];
  for (const element of [$("gl"), $("over")]) {
    if (element.width !== w || element.height !== h) { element.width = w; element.height = h; }
  }
  const show = showing(), place = MEASURES.findIndex((one) => one.name === measured());
  const variance = kindOf(now.a) === 3;
  const ramp = show !== 3 ? "viridis" : measured() === "signed" ? "signed" : "magma";
  canvas.draw({
    a: now.a, b: now.b, x: state.x, y: state.y, scale: state.scale, gain: gain(), wipe: state.wipe * w, range: state.range || 1,
    tone: state.tone, channel: state.channel, show, measure: place, kindA: kindOf(now.a), kindB: kindOf(now.b), ramp,
  });
  $("line").hidden = show !== 2;
  $("line").style.left = `${100 * state.wipe}%`;
  const both = show === 2 || show === 3, [of, from] = state.mode === "direction" ? ["Direction to ", "from "] : ["Error of ", "against "];
  $("tag-a").textContent = now.a && (show !== 1) ? (show === 3 ? of : "") + frameName(now.a.frame) : "";
  $("tag-b").textContent = now.b && (both || show === 1) ? (show === 3 ? from : "") + frameName(now.b.frame) : "";
  drawBar(show, ramp, variance);
  drawValues(show);
}

/// The colour bar, where colours are numbers.
function drawBar(show, ramp, variance) {
  const falseColour = show !== 3 && (state.tone === 4 || variance);
  $("bar").hidden = !(show === 3 || falseColour) || !now.a;
  if ($("bar").hidden) return;
  const context = $("ramp").getContext("2d"), pixels = new ImageData(256, 1);
  pixels.data.set(RAMPS[ramp]);
  context.putImageData(pixels, 0, 0);
  const spans = $("bar").querySelectorAll("span"), label = MEASURES.find((one) => one.name === measured()).label;
  const ends = show === 3 ? measured() === "signed" ? [-state.range, label, state.range] : [0, label, state.range]
    : variance ? [2 ** -18, "variance x gain²", 2 ** 6] : [2 ** -6, "luminance, log", 2 ** 6];
  ends.forEach((text, i) => { spans[i].textContent = typeof text === "number" ? short(text) : text; });
}

/// Numbers in the pixels, where these are large enough.
function drawValues(show) {
  const over = $("over"), context = over.getContext("2d"), ratio = pixelRatio(), s = state.scale;
  context.clearRect(0, 0, over.width, over.height);
  if (!now.a || s < 56 * ratio) return;
  const image = show === 1 ? now.b : now.a, size = Math.min(s / 6.2, 15 * ratio);
  context.font = `${size}px ui-monospace, Menlo, Consolas, monospace`;
  context.textAlign = "center";
  const ends = (corner, length, limit) => [Math.max(0, Math.floor(-corner / s)), Math.min(limit, Math.ceil((length - corner) / s))];
  const [x0, x1] = ends(state.x, over.width, image.w), [y0, y1] = ends(state.y, over.height, image.h);
  for (let y = y0; y < y1; y++) {
    for (let x = x0; x < x1; x++) {
      const centre = state.x + (x + 0.5) * s;
      const from = show === 2 && centre > state.wipe * over.width ? now.b : image, i = y * image.w + x;
      const lines = show === 3 ? [[short(errorAt(i)), "#fff"]] :
        [0, 1, 2].map((k) => [short(valueOf(from, i, k)), ["#ff9c96", "#8ee59a", "#9cc4ff"][k]]);
      lines.forEach(([text, colour], k) => {
        const at = state.y + (y + 0.5) * s + (k - (lines.length - 1) / 2 + 0.35) * size * 1.25;
        context.lineWidth = 3 * ratio;
        context.strokeStyle = "rgba(0,0,0,.85)";
        context.strokeText(text, centre, at);
        context.fillStyle = colour;
        context.fillText(text, centre, at);
      });
    }
  }
}

/// The whole image, as large as it fits.
function fit() {
  if (!now.a) return;
  const box = $("view"), ratio = pixelRatio(), [w, h] = [box.clientWidth * ratio, box.clientHeight * ratio];
  const most = Math.min((w - 16) / now.a.w, (h - 16) / now.a.h);
  state.scale = most >= 2 ? Math.floor(most) : Math.max(most, 0.01);
  state.x = Math.round((w - now.a.w * state.scale) / 2);
  state.y = Math.round((h - now.a.h * state.scale) / 2);
  state.fitted = true;
  showZoom();
  redraw();
}

/// Zooms by a factor; the point at (x, y) of the screen stays.
function zoom(by, x, y) {
  if (!now.a) return;
  const box = $("view"), ratio = pixelRatio();
  const [cx, cy] = [(x ?? box.clientWidth / 2) * ratio, (y ?? box.clientHeight / 2) * ratio];
  const scale = Math.min(256, Math.max(0.05, state.scale * by)), k = scale / state.scale;
  Object.assign(state, { x: cx - (cx - state.x) * k, y: cy - (cy - state.y) * k, scale, fitted: false });
  showZoom();
  redraw();
}

function setMode(mode) {
  const other = (mode === "direction") !== (state.mode === "direction");
  state.mode = mode;
  state.swapped = false;
  clearInterval(timer);
  if (mode === "flip") timer = setInterval(() => { state.swapped = !state.swapped; showProbe(); redraw(); }, 700);
  // Directions have a B of their own.
  if (other) return void refresh();
  measure();
  showPanels();
  redraw();
  remember();
}

/// Exposure so that the 99th percentile of A's largest channel is 1.
function normalize() {
  if (!now.a) return;
  const values = Array.from({ length: now.a.w * now.a.h }, (_, i) => Math.max(...[0, 1, 2].map((k) => lightOf(now.a, i, k))));
  const known = values.filter((v) => Number.isFinite(v) && v > 0).sort((p, q) => p - q);
  if (known.length) setExposure(-Math.log2(known[Math.floor(0.99 * (known.length - 1))]));
}

function setExposure(ev) {
  state.ev = Math.min(12, Math.max(-12, Math.round(10 * ev) / 10));
  changed();
}

/// After a change of exposure, tone, channel or measure.
function changed() {
  measure();
  showPanels();
  redraw();
  remember();
}

/// The state as the end of the address, so that a link leads back to it.
function remember() {
  const { scene, a, b, mode, ev, tone, channel, measure } = state;
  const told = { scene: index.scenes[scene].key, a: index.frames[a].id, b: b === null ? "" : index.frames[b].id, mode, ev, tone, channel, measure };
  history.replaceState(null, "", "#" + new URLSearchParams(told));
}

function recall() {
  const told = new URLSearchParams(location.hash.slice(1));
  const frame = (id) => index.frames.findIndex((one) => one.id === id);
  const scene = index.scenes.findIndex((one) => one.key === told.get("scene"));
  if (scene >= 0) state.scene = scene;
  if (frame(told.get("a")) >= 0) state.a = frame(told.get("a"));
  if (frame(told.get("b")) >= 0) state.b = frame(told.get("b"));
  if (["single", "wipe", "flip", "error", "direction"].includes(told.get("mode"))) state.mode = told.get("mode");
  if (MEASURES.some((one) => one.name === told.get("measure"))) state.measure = told.get("measure");
  const number = (name, most) => { const v = Number(told.get(name)); return told.has(name) && v >= 0 && v < most ? Math.floor(v) : 0; };
  state.tone = number("tone", TONES.length);
  state.channel = number("channel", CHANNELS.length);
  const ev = Number(told.get("ev"));
  if (Math.abs(ev) <= 12) state.ev = ev;
}
