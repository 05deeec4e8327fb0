// The list of scenes: filters, order, and rows that exist only while they are seen.

const ROW = 56;
const thumbs = new Map();
let listed = [];

/// The thumbnail of a scene as {w, h, rgb bytes}; they come in parts of `index.thumbs`.
function thumbOf(number) {
  const block = Math.floor(number / index.thumbs);
  if (!thumbs.has(block)) {
    const name = `t${String(block).padStart(4, "0")}`;
    thumbs.set(block, part(name).then((content) => content.thumbs).catch(() => []));
  }
  return thumbs.get(block).then((all) => all[number - block * index.thumbs]);
}

/// Columns that scenes can be ordered by: [label, values by scene, whether large values come first].
function orders() {
  const names = index.scenes.map((scene) => scene.key), sorted = [...names].sort();
  const places = new Map(sorted.map((name, place) => [name, place]));
  const byName = ["Name", names.map((name) => places.get(name)), false];
  const found = names.every((name, i) => name === sorted[i]) ? [byName] : [["As listed", null, false], byName];
  for (const metric of index.metrics) {
    for (const [frame, values] of Object.entries(metric.values)) {
      found.push([`${metric.name}: ${frameName(frame)}`, values, false, metric.unit]);
      found.push([`${metric.name}: ${frameName(frame)}, largest first`, values, true, metric.unit]);
    }
  }
  for (const [name, values] of Object.entries(index.measures)) found.push([`Gate: ${name}`, values, true, ""]);
  return found;
}
const ORDERS = orders();

function option(select, value, text) {
  select.add(new Option(text, value));
}

function fillFilters() {
  const strata = [...new Set(index.scenes.map((scene) => scene.stratum))].sort();
  option($("stratum"), "", "All strata");
  for (const stratum of strata) option($("stratum"), stratum, stratum || "no stratum");
  $("stratum").hidden = strata.length < 2;
  const judged = index.scenes.some((scene) => scene.reasons);
  $("verdict").hidden = !judged;
  if (judged) {
    for (const [value, text] of [["", "All verdicts"], ["+", "Accepted"], ["-", "Rejected"]]) option($("verdict"), value, text);
    const reasons = new Map();
    for (const scene of index.scenes) for (const reason of scene.reasons || []) reasons.set(reason, (reasons.get(reason) || 0) + 1);
    for (const [reason, count] of [...reasons].sort()) option($("verdict"), reason, `${reason} (${count})`);
  }
  $("stratum").classList.toggle("alone", !judged);
  $("verdict").classList.toggle("alone", strata.length < 2);
  ORDERS.forEach(([label], i) => option($("sort"), i, label));
}

function refilter() {
  const text = $("search").value.trim().toLowerCase(), stratum = $("stratum").value, verdict = $("verdict").value;
  const fits = (scene) => scene.key.toLowerCase().includes(text) && (stratum === "" || scene.stratum === stratum) &&
    (verdict === "" || (verdict === "+" ? scene.reasons && !scene.reasons.length :
      verdict === "-" ? scene.reasons && scene.reasons.length : scene.reasons && scene.reasons.includes(verdict)));
  listed = index.scenes.map((_, i) => i).filter((i) => fits(index.scenes[i]));
  const [, values, falling] = ORDERS[$("sort").value || 0];
  if (values) {
    // Scenes without a value come last.
    const of = (i) => values[i] ?? null;
    listed.sort((i, j) => (of(i) === null) - (of(j) === null) || (falling ? of(j) - of(i) : of(i) - of(j)) || i - j);
  }
  $("count").textContent = listed.length === index.scenes.length ? `${listed.length} scenes` : `${listed.length} of ${index.scenes.length} scenes`;
  $("rows").style.height = `${listed.length * ROW}px`;
  $("rows").replaceChildren();
  seeRows();
}

/// Makes the rows that are in sight, and drops the others.
function seeRows() {
  const box = $("list"), first = Math.max(0, Math.floor(box.scrollTop / ROW) - 4);
  const last = Math.min(listed.length, Math.ceil((box.scrollTop + box.clientHeight) / ROW) + 4);
  const have = new Map([...$("rows").children].map((row) => [Number(row.dataset.place), row]));
  for (const [place, row] of have) if (place < first || place >= last) row.remove();
  for (let place = first; place < last; place++) if (!have.has(place)) $("rows").append(makeRow(place));
  markRow();
}

function makeRow(place) {
  const number = listed[place], scene = index.scenes[number], row = document.createElement("div");
  row.className = "item";
  row.dataset.place = place;
  row.dataset.scene = number;
  row.setAttribute("role", "option");
  row.id = `scene-${number}`;
  row.style.top = `${place * ROW}px`;
  const picture = document.createElement("canvas"), text = document.createElement("div");
  const name = document.createElement("b"), told = document.createElement("span");
  picture.width = picture.height = 48;
  name.textContent = name.title = scene.key;
  const [, values, , unit] = ORDERS[$("sort").value || 0];
  const rejected = scene.reasons && scene.reasons.length;
  told.textContent = values ? `${short(values[number] ?? null)} ${unit || ""}` : rejected ? scene.reasons.join(", ") : scene.stratum;
  told.classList.toggle("bad", Boolean(rejected && !values));
  text.append(name, told);
  row.append(picture, text);
  row.onclick = () => { goTo(number); closeDrawers(); };
  thumbOf(number).then((thumb) => thumb && drawThumb(picture, thumb));
  return row;
}

function drawThumb(canvas, { w, h, d }) {
  const bytes = atob(d), pixels = new ImageData(w, h);
  for (let i = 0; i < w * h; i++) {
    for (let k = 0; k < 3; k++) pixels.data[4 * i + k] = bytes.charCodeAt(3 * i + k);
    pixels.data[4 * i + 3] = 255;
  }
  canvas.width = w;
  canvas.height = h;
  canvas.style.objectFit = "contain";
  canvas.getContext("2d").putImageData(pixels, 0, 0);
}

function markRow() {
  for (const row of $("rows").children) row.setAttribute("aria-selected", Number(row.dataset.scene) === state.scene);
  $("list").setAttribute("aria-activedescendant", `scene-${state.scene}`);
}

/// Brings the row of the current scene into sight.
function revealRow() {
  const place = listed.indexOf(state.scene), box = $("list");
  if (place >= 0 && (place * ROW < box.scrollTop || (place + 1) * ROW > box.scrollTop + box.clientHeight)) {
    box.scrollTop = place * ROW - box.clientHeight / 2 + ROW / 2;
  }
  markRow();
}

function step(by) {
  if (!listed.length) return;
  const at = listed.indexOf(state.scene);
  goTo(listed[at < 0 ? 0 : (at + by + listed.length) % listed.length]);
}
