// The canvas: textures of half floats, and one shader for tone maps, the wipe and errors.

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D imageA, imageB, mapRamp, scalar;
uniform vec2 origin, size, extent;      // screen position and size of the image in pixels; size of the image itself
uniform float height, gain, wipe, range;
uniform int tone, channel, show, measure, kindA, kindB;  // show: 0 A, 1 B, 2 wipe, 3 error
out vec4 colour;

vec3 unsrgb(vec3 v) { return mix(v / 12.92, pow((max(v, 0.04) + 0.055) / 1.055, vec3(2.4)), step(0.04045, v)); }
vec3 srgb(vec3 v) { return mix(12.92 * v, 1.055 * pow(max(v, 1e-9), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, v)); }
float luminance(vec3 v) { return dot(v, vec3(0.2126, 0.7152, 0.0722)); }
vec3 ramp(float t) { return texture(mapRamp, vec2((clamp(t, 0.0, 1.0) * 255.0 + 0.5) / 256.0, 0.5)).rgb; }

vec3 picked(vec3 v) {
  if (channel == 4) return vec3(luminance(v));
  return channel == 0 ? v : vec3(v[channel - 1]);
}

vec3 toned(vec3 v, int kind) {
  if (kind == 1) return srgb(clamp(picked(v), 0.0, 1.0));            // albedo, without exposure
  if (kind == 2) return picked(0.5 + 0.5 * v);                       // normals
  if (kind == 3) return ramp(log2(max(luminance(v) * gain * gain, 1e-12)) / 24.0 + 0.75);  // variance
  if (kind == 4) v = unsrgb(clamp(v, 0.0, 1.0));                     // display values
  vec3 x = picked(v) * gain;
  if (tone == 4) return ramp(log2(max(luminance(v) * gain, 1e-9)) / 12.0 + 0.5);
  if (tone == 1) { x = max(x, 0.0); return pow(x / (1.0 + x), vec3(1.0 / 2.2)); }
  if (tone == 2) x = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14);
  x = clamp(x, 0.0, 1.0);
  return tone == 3 ? x : srgb(x);
}

void main() {
  vec2 screen = vec2(gl_FragCoord.x, height - gl_FragCoord.y);
  vec2 at = (screen - origin) / size;
  if (any(lessThan(at, vec2(0.0))) || any(greaterThanEqual(at, vec2(1.0)))) { discard; }
  vec3 a = texture(imageA, at).rgb, b = texture(imageB, at).rgb;
  if (show == 3) {
    float v;
    vec3 d = (a - b) * gain;
    if (measure == 4) v = texture(scalar, at).r;
    else if (measure == 0) v = dot(picked(d * d), vec3(1.0 / 3.0));
    else if (measure == 1) { vec3 s = picked(a - b); v = dot(s * s / (picked(b) * picked(b) + 0.01), vec3(1.0 / 3.0)); }
    else if (measure == 2) v = dot(abs(picked(d)), vec3(1.0 / 3.0));
    else v = 0.5 * (channel == 0 ? luminance(d) : picked(d).x) + 0.5 * range;
    colour = vec4(any(isnan(a)) || any(isnan(b)) ? vec3(1.0, 0.0, 1.0) : ramp(v / range), 1.0);
    return;
  }
  bool second = show == 1 || (show == 2 && screen.x > wipe);
  vec3 v = second ? b : a;
  // Values that are not finite are magenta, wherever they are.
  colour = vec4(any(isnan(v)) || any(isinf(v)) ? vec3(1.0, 0.0, 1.0) : toned(v, second ? kindB : kindA), 1.0);
}`;

class Canvas {
  constructor(element) {
    this.element = element;
    const gl = element.getContext("webgl2", { antialias: false, alpha: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser offers no WebGL2; open the page in a current browser with graphics acceleration");
    this.gl = gl;
    this.program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.program));
    gl.useProgram(this.program);
    gl.bindVertexArray(gl.createVertexArray());
    this.places = new Map();
    this.textures = new Map();
    this.ramps = {};
    for (const [name, colours] of Object.entries(RAMPS)) this.ramps[name] = this.make(256, 1, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, colours);
    this.none = this.make(1, 1, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  make(w, h, inner, format, type, data) {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, w, h, 0, format, type, data);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }

  /// The texture of an image; the last ones are kept.
  texture(image) {
    let texture = this.textures.get(image.id);
    if (!texture) {
      const gl = this.gl, limit = gl.getParameter(gl.MAX_TEXTURE_SIZE);
      if (image.w > limit || image.h > limit) throw new Error(`the image has ${image.w} x ${image.h} pixels; this browser shows up to ${limit} a side`);
      const pixels = new Uint16Array(image.w * image.h * 4);
      for (let i = 0; i < image.w * image.h; i++) {
        for (let k = 0; k < 3; k++) pixels[4 * i + k] = image.half[i * image.c + Math.min(k, image.c - 1)];
        pixels[4 * i + 3] = 0x3c00;
      }
      texture = this.make(image.w, image.h, gl.RGBA16F, gl.RGBA, gl.HALF_FLOAT, pixels);
    }
    this.textures.delete(image.id);
    this.textures.set(image.id, texture);
    while (this.textures.size > 24) {
      const [oldest, gone] = this.textures.entries().next().value;
      this.gl.deleteTexture(gone);
      this.textures.delete(oldest);
    }
    return texture;
  }

  /// A map of numbers, such as FLIP's.
  scalar(map, w, h) {
    if (this.map) this.gl.deleteTexture(this.map);
    this.map = this.make(w, h, this.gl.R16F, this.gl.RED, this.gl.FLOAT, map);
  }

  /// The values of an image as the graphics processor has them, [height, width, 4], top row first.
  readBack(image) {
    const gl = this.gl;
    if (!gl.getExtension("EXT_color_buffer_float")) throw new Error("EXT_color_buffer_float is not supported");
    const buffer = gl.createFramebuffer(), out = new Float32Array(image.w * image.h * 4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture(image), 0);
    gl.readPixels(0, 0, image.w, image.h, gl.RGBA, gl.FLOAT, out);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(buffer);
    return out;
  }

  draw(view) {
    const gl = this.gl, { width, height } = this.element;
    const set = (name, call, ...values) => {
      if (!this.places.has(name)) this.places.set(name, gl.getUniformLocation(this.program, name));
      gl[call](this.places.get(name), ...values);
    };
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!view.a) return;
    const bind = (unit, name, texture, smooth) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, smooth ? gl.LINEAR : gl.NEAREST);
      set(name, "uniform1i", unit);
    };
    // A new texture is bound to the active unit, so that both are made before one is bound.
    const a = this.texture(view.a), b = view.b ? this.texture(view.b) : this.none;
    bind(0, "imageA", a, view.scale < 1);
    bind(1, "imageB", b, view.scale < 1);
    bind(2, "mapRamp", this.ramps[view.ramp], false);
    bind(3, "scalar", this.map || this.none, view.scale < 1);
    set("origin", "uniform2f", view.x, view.y);
    set("size", "uniform2f", view.a.w * view.scale, view.a.h * view.scale);
    for (const name of ["gain", "wipe", "range"]) set(name, "uniform1f", view[name]);
    set("height", "uniform1f", height);
    for (const name of ["tone", "channel", "show", "measure", "kindA", "kindB"]) set(name, "uniform1i", view[name]);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
