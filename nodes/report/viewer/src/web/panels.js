// The panels around the canvas: images, steps, measures, pixel values.

function make(tag, options, ...children) {
  const element = Object.assign(document.createElement(tag), options);
  element.append(...children);
  return element;
}

/// Frames of a track that the scene has.
const framesOf = (track) => index.frames.map((_, i) => i).filter((i) => index.frames[i].track === track && now.data && now.data.packed[i])
  .sort((p, q) => index.frames[p].order - index.frames[q].order);

function showPanels() {
  const scene = index.scenes[state.scene];
  $("title").replaceChildren(scene.key, make("small", { textContent: index.title }));
  for (const button of $("modes").children) {
    const direction = button.dataset.mode === "direction", has = direction ? now.a && beforeOf(now.data, now.a.frame) !== null : now.b || state.mode === "direction";
    button.setAttribute("aria-pressed", button.dataset.mode === (now.b ? state.mode : "single"));
    button.disabled = button.dataset.mode !== "single" && !has;
  }
  showTracks();
  showSteps();
  showError();
  showFacts();
  showGate(scene);
  showProbe();
  showHistogram();
  $("ev").value = state.ev;
  $("ev-text").textContent = `${state.ev > 0 ? "+" : ""}${state.ev.toFixed(1)} EV`;
  $("tone").value = state.tone;
  $("tone").title = TONES[state.tone].text;
  $("channel").value = state.channel;
}

/// The figure of a frame in this scene, such as its PSNR.
function figure(frame) {
  const metric = index.metrics[0], values = metric && metric.values[frame];
  const value = values ? values[state.scene] ?? null : null;
  return value === null ? "" : `${metric.name} ${short(value)} ${metric.unit}`;
}

/// Tracks in the order of the panel: pictures first.
const hasPictures = (track) => index.frames.some((frame, i) => frame.track === track && isPicture(i));
const TRACKS = index.tracks.map((_, i) => i).sort((p, q) => hasPictures(q) - hasPictures(p) || p - q);

function showTracks() {
  const a = now.a && now.a.frame, b = now.b && now.b.frame;
  const scrolled = $("tracks").scrollTop;
  $("tracks").replaceChildren(...TRACKS.map((number) => {
    const track = index.tracks[number], frames = framesOf(number);
    const chips = frames.map((frame) => {
      const label = index.frames[frame].label, told = figure(frame);
      const first = make("button", { textContent: label, title: told || `Show ${frameName(frame)}`, onclick: () => choose("a", frame) });
      const second = make("button", { textContent: "B", className: "pickb", title: `Compare with ${frameName(frame)}`, onclick: () => choose("b", frame) });
      first.setAttribute("aria-pressed", frame === a);
      second.setAttribute("aria-pressed", frame === b);
      return make("div", { className: `chip${frame === a ? " a" : ""}${frame === b ? " b" : ""}` }, first, second);
    });
    return make("div", { className: "track", hidden: !frames.length }, make("b", { textContent: track.name }),
      ...(track.between === undefined ? [] : [make("small", { textContent: "states of the solver, not renders" })]), make("div", { className: "chips" }, ...chips));
  }));
  const box = $("tracks"), chip = box.querySelector(".chip.a");
  box.scrollTop = scrolled;
  if (!chip) return;
  const top = chip.offsetTop - box.offsetTop;
  if (top < box.scrollTop || top + chip.offsetHeight > box.scrollTop + box.clientHeight) box.scrollTop = top - box.clientHeight / 2;
}

/// The rail: the states of A's track at their times, and nothing between them. States of a solver have the rungs that
/// they lie between beside them.
function showSteps() {
  const rail = $("rail");
  if (!now.a) return rail.replaceChildren();
  const track = index.frames[now.a.frame].track, { between } = index.tracks[track];
  const tau = (frame) => index.frames[frame].tau;
  const frames = between === undefined ? framesOf(track)
    : [...framesOf(between).filter((frame) => framesOf(track).every((own) => Math.abs(tau(own) - tau(frame)) > 1e-6)), ...framesOf(track)].sort((p, q) => tau(p) - tau(q));
  const times = frames.map((frame) => index.frames[frame].tau);
  const timed = times.every((tau) => tau !== null) && new Set(times).size === times.length;
  let last = -Infinity;
  rail.replaceChildren(...frames.map((frame, i) => {
    const at = timed ? times[i] : frames.length > 1 ? i / (frames.length - 1) : 0;
    const name = make("em", { textContent: index.frames[frame].label });
    const stop = make("button", { className: `stop${now.b && now.b.frame === frame ? " b" : ""}${between === undefined ? "" : index.frames[frame].track === track ? " own" : " rung"}`, onclick: () => choose("a", frame) }, name);
    stop.style.left = `${100 * Math.min(1, Math.max(0, at))}%`;
    stop.title = `${frameName(frame)}${times[i] === null ? "" : `, tau ${times[i].toFixed(3)}`} ${figure(frame)}`;
    stop.setAttribute("aria-label", stop.title);
    stop.setAttribute("aria-current", frame === now.a.frame);
    // Labels that would touch the one before are left out, but not that of the current state.
    const place = at * rail.clientWidth, room = 7 * name.textContent.length + 6;
    const seen = frame === now.a.frame || place - last >= room;
    name.classList.toggle("off", !seen);
    if (seen) last = place;
    return stop;
  }));
  const current = frames.indexOf(now.a.frame);
  const labels = [...rail.children].map((stop) => stop.firstChild);
  for (const near of [current - 1, current + 1]) {
    const gap = labels[near] && Math.abs(parseFloat(rail.children[near].style.left) - parseFloat(rail.children[current].style.left));
    if (labels[near] && gap / 100 * rail.clientWidth < 7 * labels[near].textContent.length) labels[near].classList.add("off");
  }
  const steps = framesOf(track), place = steps.indexOf(now.a.frame);
  $("step-back").disabled = place <= 0;
  $("step-on").disabled = place >= steps.length - 1;
}

/// Goes along A's track, or to another track.
function move(by, across) {
  if (!now.a) return;
  const own = index.frames[now.a.frame].track, frames = framesOf(own), place = frames.indexOf(now.a.frame);
  if (!across) return void (frames[place + by] !== undefined && choose("a", frames[place + by]));
  const tracks = TRACKS.filter((i) => framesOf(i).length);
  const to = framesOf(tracks[(tracks.indexOf(own) + by + tracks.length) % tracks.length]);
  choose("a", to[Math.min(place, to.length - 1)]);
}

function showError() {
  $("error-box").hidden = !now.b;
  if (!now.b || !now.a) return;
  $("measure").value = measured();
  $("range").value = Number((state.range || 0).toPrecision(4));
  $("auto").setAttribute("aria-pressed", state.automatic);
  const { a, b } = now, count = a.w * a.h, sums = [0, 0, 0], g = gain();
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < 3; k++) {
      const p = valueOf(a, i, k), q = valueOf(b, i, k), d = (p - q) * g;
      sums[0] += d * d;
      sums[1] += (p - q) ** 2 / (q * q + 0.01);
      sums[2] += Math.abs(d);
    }
  }
  const [mse, relative, absolute] = sums.map((v) => v / (3 * count));
  const rows = [["MSE", short(mse)], ["PSNR, peak 1", mse === 0 ? "equal" : `${short(-10 * Math.log10(mse))} dB`],
    ["relMSE (+0.01)", short(relative)], ["MAE", short(absolute)]];
  if (maps() && measured() === "flip" && now.error) {
    rows.push(["mean FLIP, as displayed", short(now.error.map.reduce((sum, v) => sum + v, 0) / count)]);
  }
  $("stats").replaceChildren(...rows.map(([name, value]) => make("tr", {}, make("th", { textContent: name }), make("td", { textContent: value }))));
}

function showFacts() {
  if (!now.a) return $("facts").replaceChildren();
  const { a } = now, frame = index.frames[a.frame], [absolute, relative] = a.error;
  const space = { radiance: index.tracks[frame.track].space, albedo: "albedo", normal: "normals of the camera's frame, (n + 1)/2", variance: "variance of single samples, raw radiance", display: index.tracks[frame.track].space };
  const facts = [["Image", frameName(a.frame)], ["Size", `${a.w} x ${a.h}`], ["Values", space[frame.content]],
    ["Half floats", `off by at most ${short(absolute)}; relative ${short(relative)}${a.clipped ? `; ${a.clipped} values beyond 65504 were clipped` : ""}`]];
  if (index.scenes[state.scene].exposure) facts.splice(3, 0, ["Exposure", `${short(index.scenes[state.scene].exposure)} x raw radiance`]);
  if (frame.tau !== null) facts.push(["tau", frame.tau.toFixed(4)]);
  for (const metric of index.metrics) {
    const value = (metric.values[a.frame] || [])[state.scene];
    if (value !== undefined && value !== null) facts.push([metric.name, `${short(value)} ${metric.unit}`]);
  }
  $("facts").replaceChildren(...facts.flatMap(([name, value]) => [make("dt", { textContent: name }), make("dd", { textContent: value })]));
}

function showGate(scene) {
  $("gate-box").hidden = !scene.reasons;
  if (!scene.reasons) return;
  const told = scene.reasons.length ? `Rejected: ${scene.reasons.map((reason) => index.reasons[reason] ? `${reason} (${index.reasons[reason]})` : reason).join("; ")}` : "Accepted";
  const rows = Object.entries(index.measures).filter(([, values]) => (values[state.scene] ?? null) !== null)
    .map(([name, values]) => make("tr", {}, make("th", { textContent: name }), make("td", { textContent: short(values[state.scene]) })));
  $("gate").replaceChildren(make("p", { textContent: told }), make("table", {}, ...rows));
}

function showZoom() {
  const percent = 100 * state.scale / pixelRatio();
  $("zoom-one").textContent = `${percent >= 10 ? Math.round(percent) : percent.toFixed(1)}%`;
}

/// The pixel under the pointer, of both images.
function showProbe() {
  const at = state.probe, probe = $("probe");
  if (!at || !now.a || at.x < 0 || at.y < 0 || at.x >= now.a.w || at.y >= now.a.h) {
    probe.textContent = now.a ? `Point at a pixel for its values. ${now.a.w} x ${now.a.h}` : "";
    return;
  }
  const i = at.y * now.a.w + at.x, values = (image) => [0, 1, 2].map((k) => valueOf(image, i, k));
  const text = (v) => v.map((x) => short(x).padStart(9)).join(" ");
  const lines = [make("span", { className: "a", textContent: `A ${text(values(now.a))}` })];
  if (now.b) {
    lines.push("  ", make("span", { className: "b", textContent: `B ${text(values(now.b))}` }), "\n",
      make("span", { className: "d", textContent: `A-B ${text(values(now.a).map((v, k) => v - values(now.b)[k]))}` }));
    if (maps() && now.error) lines.push(`  ${MEASURES.find((one) => one.name === measured()).label.toLowerCase()} ${short(errorAt(i))}`);
  }
  probe.replaceChildren(`(${at.x}, ${at.y})  `, ...lines);
}

function showHistogram() {
  const box = $("histogram"), context = box.getContext("2d"), bins = 96, [low, high] = [-10, 6];
  context.clearRect(0, 0, box.width, box.height);
  const count = (image) => {
    const out = new Float32Array(bins);
    for (let i = 0; i < image.w * image.h; i++) {
      const v = Math.log2(luminance(image, i) * gain());
      if (v > -Infinity) out[Math.min(bins - 1, Math.max(0, Math.floor((v - low) / (high - low) * bins)))]++;
    }
    return out;
  };
  const sides = [[now.b, "#ffb454"], [now.a, "#58a6ff"]].filter(([image]) => image && isPicture(image.frame)).map(([image, colour]) => [count(image), colour]);
  const most = Math.max(1, ...sides.flatMap(([values]) => [...values]));
  for (const [values, colour] of sides) {
    context.strokeStyle = colour;
    context.lineWidth = 3;
    context.beginPath();
    values.forEach((v, i) => context[i ? "lineTo" : "moveTo"]((i + 0.5) / bins * box.width, (box.height - 6) * (1 - v / most) + 3));
    context.stroke();
  }
  context.strokeStyle = "rgba(255,255,255,.3)";
  context.lineWidth = 1;
  context.beginPath();
  const one = -low / (high - low) * box.width;
  context.moveTo(one, 0);
  context.lineTo(one, box.height);
  context.stroke();
}
