// Pointer, touch and keys; then the page begins.

const KEYS = [
  ["← →", "previous, next state of the same track"], ["↑ ↓", "previous, next track"], ["[ ]", "previous, next scene"],
  ["1 2 3 4 5", "A, wipe, flip, error, direction"], ["Space", "swap A and B in sight"], ["E, Shift+E", "exposure up, down by half a stop"],
  ["N", "normalize exposure"], ["R", "reset exposure, tone map and channel"], ["T", "next tone map"], ["C", "next channel"],
  ["M", "next measure of error"], ["+ − 0", "zoom in, out, to 100%"], ["F", "fit"], ["B", "compare with the image that is A"],
  ["/", "find a scene"], ["?", "this list"], ["Wheel, pinch", "zoom; pixel values show when pixels are large"], ["Drag", "pan; move the line of the wipe"],
];

function closeDrawers() {
  for (const drawer of [$("scenes"), $("side")]) drawer.classList.remove("open");
}

/// The pixel of the image at a point of the screen.
function pixelAt(x, y) {
  const ratio = pixelRatio();
  return { x: Math.floor((x * ratio - state.x) / state.scale), y: Math.floor((y * ratio - state.y) / state.scale) };
}

function listenToPointers() {
  const view = $("view"), held = new Map();
  let wiping = false;
  const local = (event) => { const box = view.getBoundingClientRect(); return { x: event.clientX - box.left, y: event.clientY - box.top }; };
  const spread = () => { const [p, q] = [...held.values()]; return { d: Math.hypot(p.x - q.x, p.y - q.y), x: (p.x + q.x) / 2, y: (p.y + q.y) / 2 }; };
  view.addEventListener("pointerdown", (event) => {
    view.setPointerCapture(event.pointerId);
    held.set(event.pointerId, local(event));
    wiping = $("line").contains(event.target);
    closeDrawers();
  });
  view.addEventListener("pointermove", (event) => {
    const at = local(event), before = held.get(event.pointerId);
    state.probe = pixelAt(at.x, at.y);
    showProbe();
    if (!before) return;
    if (wiping) {
      state.wipe = Math.min(1, Math.max(0, at.x / view.clientWidth));
    } else if (held.size === 2) {
      const old = spread();
      held.set(event.pointerId, at);
      const fresh = spread();
      if (old.d > 0) zoom(fresh.d / old.d, fresh.x, fresh.y);
      state.x += (fresh.x - old.x) * pixelRatio();
      state.y += (fresh.y - old.y) * pixelRatio();
    } else {
      state.x += (at.x - before.x) * pixelRatio();
      state.y += (at.y - before.y) * pixelRatio();
      state.fitted = false;
    }
    held.set(event.pointerId, at);
    redraw();
  });
  for (const end of ["pointerup", "pointercancel"]) {
    view.addEventListener(end, (event) => {
      const at = local(event);
      if (held.size === 1) { state.probe = pixelAt(at.x, at.y); showProbe(); }
      held.delete(event.pointerId);
      wiping = false;
    });
  }
  view.addEventListener("wheel", (event) => {
    event.preventDefault();
    const at = local(event);
    zoom(1.0015 ** -event.deltaY, at.x, at.y);
  }, { passive: false });
  view.addEventListener("dblclick", fit);
  // Dragged along the rail, the nearest real state is shown.
  const rail = $("rail");
  const slide = (event) => {
    const box = rail.getBoundingClientRect(), at = 100 * (event.clientX - box.left) / box.width;
    const gap = (stop) => Math.abs(parseFloat(stop.style.left) - at);
    const near = [...rail.children].sort((p, q) => gap(p) - gap(q))[0];
    if (near && near.getAttribute("aria-current") !== "true") near.onclick();
  };
  rail.addEventListener("pointerdown", (event) => { if (event.target === rail) { rail.setPointerCapture(event.pointerId); slide(event); } });
  rail.addEventListener("pointermove", (event) => { if (rail.hasPointerCapture(event.pointerId)) slide(event); });
}

function listenToKeys() {
  const next = (list, at) => (at + 1) % list.length, two = () => now.b || state.mode === "direction";
  const actions = {
    ArrowLeft: () => move(-1), ArrowRight: () => move(1), ArrowUp: () => move(-1, true), ArrowDown: () => move(1, true),
    "[": () => step(-1), "]": () => step(1), PageUp: () => step(-1), PageDown: () => step(1),
    1: () => setMode("single"), 2: () => two() && setMode("wipe"), 3: () => two() && setMode("flip"), 4: () => two() && setMode("error"),
    5: () => now.a && beforeOf(now.data, now.a.frame) !== null && setMode("direction"),
    " ": () => { if (now.b) { const on = !state.swapped; setMode(state.mode === "flip" ? "flip" : "single"); clearInterval(timer); state.swapped = on; redraw(); } },
    e: () => setExposure(state.ev + 0.5), E: () => setExposure(state.ev - 0.5), n: normalize,
    r: () => { state.ev = state.tone = state.channel = 0; changed(); },
    t: () => { state.tone = next(TONES, state.tone); changed(); }, c: () => { state.channel = next(CHANNELS, state.channel); changed(); },
    m: () => setMeasure(MEASURES[next(MEASURES, MEASURES.findIndex((one) => one.name === state.measure))].name),
    "+": () => zoom(2), "=": () => zoom(2), "-": () => zoom(0.5), 0: () => zoom(pixelRatio() / state.scale), f: fit,
    b: () => now.a && choose("b", now.a.frame), "/": () => { $("scenes").classList.add("open"); $("search").focus(); },
    "?": () => $("help").showModal(), Escape: closeDrawers,
  };
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest("input:not([type=range]),select,dialog[open]");
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (typing) { if (event.key === "Escape" && event.target.blur) event.target.blur(); return; }
    // A button that has the focus keeps the keys that press it, and the slider those that move it.
    if (event.target.matches("button,a") && [" ", "Enter"].includes(event.key)) return;
    if (event.target.matches("input") && event.key.startsWith("Arrow")) return;
    const action = Object.hasOwn(actions, event.key) && actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });
}

function setMeasure(name) {
  state.measure = name;
  state.automatic = true;
  now.error = null;
  if (state.mode !== "error" && now.b) return setMode("error");
  changed();
}

function listenToControls() {
  for (const button of $("modes").children) button.onclick = () => setMode(button.dataset.mode);
  for (const button of document.querySelectorAll(".drawer")) {
    button.onclick = () => { const own = $(button.dataset.drawer), open = own.classList.contains("open"); closeDrawers(); own.classList.toggle("open", !open); seeRows(); revealRow(); };
  }
  TONES.forEach((tone, i) => option($("tone"), i, tone.name));
  CHANNELS.forEach((channel, i) => option($("channel"), i, channel));
  MEASURES.forEach((measure) => option($("measure"), measure.name, measure.label));
  $("tone").onchange = () => { state.tone = Number($("tone").value); changed(); };
  $("channel").onchange = () => { state.channel = Number($("channel").value); changed(); };
  $("measure").onchange = () => setMeasure($("measure").value);
  $("ev").oninput = () => setExposure(Number($("ev").value));
  $("range").onchange = () => { const v = Number($("range").value); if (v > 0) { state.range = v; state.automatic = false; } changed(); };
  $("auto").onclick = () => { state.automatic = true; now.error = null; if (maps()) changed(); else setMode("error"); };
  $("normal").onclick = normalize;
  $("fit").onclick = fit;
  $("zoom-in").onclick = () => zoom(2);
  $("zoom-out").onclick = () => zoom(0.5);
  $("zoom-one").onclick = () => zoom(pixelRatio() / state.scale);
  $("step-back").onclick = () => move(-1);
  $("step-on").onclick = () => move(1);
  $("help-open").onclick = () => $("help").showModal();
  $("keys").replaceChildren(...KEYS.map(([key, text]) => make("tr", {}, make("td", {}, make("kbd", { textContent: key })), make("td", { textContent: text }))));
  for (const id of ["search", "stratum", "verdict", "sort"]) $(id).addEventListener("input", refilter);
  $("list").addEventListener("scroll", seeRows, { passive: true });
  $("exr").onclick = (event) => {
    event.preventDefault();
    if (!now.a) return;
    const url = URL.createObjectURL(new Blob([exrFile(now.a)], { type: "image/x-exr" }));
    make("a", { href: url, download: `${index.scenes[state.scene].key}-${frameName(now.a.frame)}.exr`.replace(/[^\w.=+-]+/g, "_") }).click();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
  };
  new ResizeObserver(() => { if (state.fitted) fit(); showPanels(); seeRows(); redraw(); }).observe($("view"));
}

function begin() {
  document.title = `${index.title} – tauflow`;
  $("app").hidden = false;
  $("app").classList.toggle("alone", index.scenes.length < 2);
  $("foot").textContent = `${index.provenance} ${index.command}`;
  if (!index.frames.length) return tell("there is no image in these items", true);
  state.a = index.first;
  // What there is against the reference, if there is one.
  state.mode = "wipe";
  recall();
  try {
    canvas = new Canvas($("gl"));
  } catch (error) {
    return tell(error.message, true);
  }
  listenToControls();
  listenToPointers();
  listenToKeys();
  // Another link to this page; what the page itself remembers changes no address that is listened to.
  addEventListener("hashchange", () => location.reload());
  fillFilters();
  refilter();
  refresh().then(() => { if (state.mode === "flip") setMode("flip"); revealRow(); });
}

begin();
