// Tone maps, colour maps and numbers as text.

/// Tone maps, in the order of `TONE` in gl.js. `text` says what they do.
const TONES = [
  { name: "sRGB", text: "clipped at 1, then the sRGB curve" },
  { name: "Reinhard", text: "x/(1 + x), then gamma 2.2: as in reports" },
  { name: "ACES", text: "a filmic curve (Narkowicz 2015), then sRGB" },
  { name: "Linear", text: "clipped at 1, no curve" },
  { name: "False colour", text: "log2 of luminance, 12 stops around 1" },
];
const CHANNELS = ["RGB", "R", "G", "B", "Luminance"];
const MEASURES = [
  { name: "squared", label: "Squared error" },
  { name: "relative", label: "Relative squared error" },
  { name: "absolute", label: "Absolute error" },
  { name: "signed", label: "Signed difference" },
  { name: "flip", label: "FLIP" },
];

// Polynomials of Matt Zucker's fits to matplotlib's maps; a diverging map for signed differences.
const MAPS = {
  magma: [[-0.002136485, -0.000749655, -0.005386128], [0.251660541, 0.677523244, 2.494026599], [8.353717279, -3.577719515, 0.314467903],
    [-27.668733086, 14.264730781, -13.649213188], [52.176139812, -27.943606072, 12.944169442], [-50.768525365, 29.046582821, 4.234152994],
    [18.655705066, -11.48977352, -5.601961509]],
  viridis: [[0.277727327, 0.005407345, 0.334099805], [0.105093043, 1.40461353, 1.384590163], [-0.330861829, 0.214847559, 0.095095163],
    [-4.634230499, -5.799100973, -19.33244096], [6.228269936, 14.179933367, 56.690552601], [4.776384998, -13.745145378, -65.353032633],
    [-5.435455856, 4.645852612, 26.31243525]],
};

function mapped(name, t) {
  if (name === "signed") {
    const s = 2 * t - 1, light = 1 - Math.abs(s), dark = Math.abs(s) ** 0.7;
    const end = s < 0 ? [0.23, 0.55, 1] : [1, 0.45, 0.2];
    return end.map((v) => Math.min(1, (0.04 * light + v * dark)));
  }
  return [0, 1, 2].map((k) => Math.min(1, Math.max(0, MAPS[name].reduceRight((sum, row) => sum * t + row[k], 0))));
}

/// 256 colours [r, g, b, 255].
function ramp(name) {
  const out = new Uint8Array(1024);
  for (let i = 0; i < 256; i++) out.set([...mapped(name, i / 255).map((v) => Math.round(255 * v)), 255], 4 * i);
  return out;
}
const RAMPS = { magma: ramp("magma"), viridis: ramp("viridis"), signed: ramp("signed") };

const srgb = (v) => v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055;
const unsrgb = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
const clip = (v) => v > 0 ? Math.min(v, 1) : 0;

/// Display values [0, 1] of a linear pixel, as the shader has them.
function shown(rgb, gain, tone) {
  return rgb.map((v) => {
    const x = v * gain;
    if (tone === 1) return x > 0 ? clip(x / (1 + x)) ** (1 / 2.2) : 0;
    if (tone === 2) return srgb(clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)));
    return tone === 3 ? clip(x) : srgb(clip(x));
  });
}

/// A number in few characters.
function short(v) {
  if (v === null || v === undefined || Number.isNaN(v)) return v !== v ? "NaN" : "–";
  if (!Number.isFinite(v)) return v > 0 ? "inf" : "-inf";
  const size = Math.abs(v);
  if (size === 0) return "0";
  return size >= 1e-3 && size < 1e5 ? String(Number(v.toPrecision(4))) : v.toExponential(2);
}
