// An OpenEXR file of half floats, uncompressed, by scan lines.

function exrFile(image) {
  const { w, h, c, half } = image, bytes = [];
  const names = c === 1 ? ["Y"] : ["B", "G", "R"], order = c === 1 ? [0] : [2, 1, 0];
  const int = (v) => bytes.push(v & 255, v >> 8 & 255, v >> 16 & 255, v >>> 24);
  const float = (v) => bytes.push(...new Uint8Array(new Float32Array([v]).buffer));
  const text = (s) => bytes.push(...[...s].map((x) => x.charCodeAt(0)), 0);
  const attribute = (name, type, size) => { text(name); text(type); int(size); };
  bytes.push(0x76, 0x2f, 0x31, 0x01);
  int(2);
  attribute("channels", "chlist", names.reduce((sum, name) => sum + name.length + 17, 1));
  for (const name of names) { text(name); int(1); int(0); int(1); int(1); }
  bytes.push(0);
  attribute("compression", "compression", 1);
  bytes.push(0);
  for (const name of ["dataWindow", "displayWindow"]) { attribute(name, "box2i", 16); int(0); int(0); int(w - 1); int(h - 1); }
  attribute("lineOrder", "lineOrder", 1);
  bytes.push(0);
  attribute("pixelAspectRatio", "float", 4);
  float(1);
  attribute("screenWindowCenter", "v2f", 8);
  float(0); float(0);
  attribute("screenWindowWidth", "float", 4);
  float(1);
  bytes.push(0);
  const row = 8 + 2 * w * names.length, start = bytes.length + 8 * h;
  const out = new DataView(new ArrayBuffer(start + h * row));
  bytes.forEach((v, i) => out.setUint8(i, v));
  for (let y = 0; y < h; y++) {
    out.setUint32(bytes.length + 8 * y, start + y * row, true);
    let at = start + y * row;
    out.setInt32(at, y, true);
    out.setInt32(at + 4, row - 8, true);
    at += 8;
    for (const k of order) for (let x = 0; x < w; x++, at += 2) out.setUint16(at, half[(y * w + x) * c + k], true);
  }
  return out.buffer;
}
