// LDR-FLIP: Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020, with the constants of
// its reference implementation. Images are as displayed, in linear RGB of [0, 1]; 67.02 pixels per degree.

const FLIP_PPD = 0.7 * 3840 / 0.7 * Math.PI / 180;
const FLIP_XYZ = [[10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
  [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897], [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382]];
const FLIP_WHITE = FLIP_XYZ.map((row) => row[0] + row[1] + row[2]);
const FLIP_RGB = [[3.241003275, -1.537398934, -0.498615861], [-0.969224334, 1.875930071, 0.041554224], [0.055639423, -0.204011202, 1.057148933]];

/// Rows, then columns of a plane, each with a kernel of odd length; pixels beyond the border are those at it.
function flipConvolve(plane, w, h, across, down) {
  const pass = (from, kernel, length, lines, step, jump) => {
    const out = new Float64Array(from.length), r = kernel.length >> 1;
    for (let line = 0; line < lines; line++) {
      const base = line * jump;
      for (let i = 0; i < length; i++) {
        let sum = 0;
        for (let k = -r; k <= r; k++) {
          const at = i + k < 0 ? 0 : i + k >= length ? length - 1 : i + k;
          sum += kernel[k + r] * from[base + at * step];
        }
        out[base + i * step] = sum;
      }
    }
    return out;
  };
  return pass(pass(plane, across, w, h, 1, w), down, h, w, w, 1);
}

function flipKernel(radius, of) {
  return Float64Array.from({ length: 2 * radius + 1 }, (_, i) => of(i - radius));
}

/// Filters a plane with a weighted sum of Gaussians, normalised to 1; `terms` are [a, b] of the contrast sensitivity.
function flipSensitivity(plane, w, h, terms) {
  const radius = Math.ceil(3 * Math.sqrt(0.04 / (2 * Math.PI ** 2)) * FLIP_PPD);
  const out = new Float64Array(plane.length);
  let total = 0;
  for (const [a, b] of terms) {
    const kernel = flipKernel(radius, (x) => Math.exp(-(Math.PI ** 2) * (x / FLIP_PPD) ** 2 / b));
    const weight = a * Math.sqrt(Math.PI / b);
    total += weight * kernel.reduce((sum, v) => sum + v, 0) ** 2;
    flipConvolve(plane, w, h, kernel, kernel).forEach((v, i) => { out[i] += weight * v; });
  }
  return out.map((v) => v / total);
}

/// CIELab with Hunt's adjustment, of a linear RGB pixel.
function flipLab(r, g, b) {
  const f = FLIP_XYZ.map((row, k) => {
    const t = (row[0] * r + row[1] * g + row[2] * b) / FLIP_WHITE[k];
    return t > (6 / 29) ** 3 ? Math.cbrt(t) : t / (3 * (6 / 29) ** 2) + 4 / 29;
  });
  const light = 116 * f[1] - 16;
  return [light, 0.01 * light * 500 * (f[0] - f[1]), 0.01 * light * 200 * (f[1] - f[2])];
}

const flipDistance = (p, q) => (Math.abs(p[0] - q[0]) + Math.hypot(p[1] - q[1], p[2] - q[2])) ** 0.7;

/// Filtered colours and features of an image: `pixel(i)` is linear RGB.
function flipSide(pixel, w, h) {
  const count = w * h, planes = [0, 1, 2].map(() => new Float64Array(count));
  for (let i = 0; i < count; i++) {
    const [r, g, b] = pixel(i);
    const [x, y, z] = FLIP_XYZ.map((row, k) => (row[0] * r + row[1] * g + row[2] * b) / FLIP_WHITE[k]);
    planes[0][i] = 116 * y - 16;
    planes[1][i] = 500 * (x - y);
    planes[2][i] = 200 * (y - z);
  }
  const terms = [[[1, 0.0047]], [[1, 0.0053]], [[34.1, 0.04], [13.5, 0.025]]];
  const seen = planes.map((plane, k) => flipSensitivity(plane, w, h, terms[k]));
  const lab = Array.from({ length: count }, (_, i) => {
    const y = (seen[0][i] + 16) / 116, xyz = [y + seen[1][i] / 500, y, y - seen[2][i] / 200].map((v, k) => v * FLIP_WHITE[k]);
    return flipLab(...FLIP_RGB.map((row) => clip(row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2])));
  });
  const grey = planes[0].map((v) => (v + 16) / 116);
  const deviation = 0.5 * 0.082 * FLIP_PPD, radius = Math.ceil(3 * deviation);
  const bell = flipKernel(radius, (x) => Math.exp(-x * x / (2 * deviation ** 2)));
  const across = bell.reduce((sum, v) => sum + v, 0);
  const features = [(x) => -x, (x) => x * x / deviation ** 2 - 1].map((of) => {
    const kernel = flipKernel(radius, (x) => of(x) * Math.exp(-x * x / (2 * deviation ** 2)));
    const sum = (sign) => kernel.reduce((all, v) => all + Math.max(0, sign * v), 0) * across;
    const [positive, negative] = [sum(1), sum(-1)];
    const edge = kernel.map((v) => v > 0 ? v / positive : v / negative);
    const x = flipConvolve(grey, w, h, edge, bell), y = flipConvolve(grey, w, h, bell, edge);
    return x.map((v, i) => Math.hypot(v, y[i]));
  });
  return { lab, features };
}

/// The FLIP map of two images of w x h pixels, given as functions from a pixel's index to linear RGB in [0, 1].
function flipMap(test, reference, w, h) {
  const a = flipSide(test, w, h), b = flipSide(reference, w, h);
  const most = flipDistance(flipLab(0, 1, 0), flipLab(0, 0, 1)), knee = 0.4 * most;
  const out = new Float32Array(w * h);
  for (let i = 0; i < out.length; i++) {
    const colour = flipDistance(a.lab[i], b.lab[i]);
    const error = colour < knee ? 0.95 * colour / knee : 0.95 + 0.05 * (colour - knee) / (most - knee);
    const feature = Math.max(...[0, 1].map((k) => Math.abs(a.features[k][i] - b.features[k][i])));
    out[i] = error ** (1 - Math.sqrt(feature / Math.SQRT2));
  }
  return out;
}
