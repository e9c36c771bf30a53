// Draws the cloud with WebGL 2: one point per pixel, placed by the vertex shader from maps in textures, so that a new map takes
// one upload.

import type { Table } from "../model/colours.ts";
import type { Intrinsics } from "../service.ts";
import type { Eye } from "./matrix.ts";

/** Largest number of points drawn; larger maps are subsampled regularly. */
const MOST = 1_500_000;

const CLOUD = `#version 300 es
precision highp float;
uniform highp sampler2D depths, deviations, picture, colours;
uniform mat4 clip;
uniform vec4 camera;
uniform ivec2 size;
uniform int stride, columns, source;
uniform vec2 range, view;
uniform float cut, focal, measured;
out vec3 colour;
out float strength;
vec3 seen(ivec2 pixel, float z) { return vec3((vec2(pixel) - camera.zw) / camera.xy * z, z); }
float reach(ivec2 pixel, float z, vec2 here) {
  float next = texelFetch(depths, min(pixel, size - 1), 0).r;
  if (abs(next - z) > 0.06 * float(stride) * z) return 0.0;
  vec4 place = clip * vec4(seen(pixel, next), 1.0);
  return place.w > 0.0 ? length((place.xy / place.w - here) * view) * 0.5 : 0.0;
}
void main() {
  ivec2 pixel = stride * ivec2(gl_VertexID % columns, gl_VertexID / columns);
  float z = texelFetch(depths, pixel, 0).r;
  float deviation = texelFetch(deviations, pixel, 0).r;
  if (!(z > 0.0) || deviation > cut) {
    gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
    gl_PointSize = 0.0;
    return;
  }
  strength = deviation > measured * z ? 0.25 : 1.0;
  gl_Position = clip * vec4(seen(pixel, z), 1.0);
  float width = float(stride) * z / camera.x * focal / max(gl_Position.w, 1e-6);
  // Wide enough to touch the next pixels of the same surface, seen from here.
  vec2 here = gl_Position.xy / gl_Position.w;
  float gap = max(reach(pixel + ivec2(stride, 0), z, here), reach(pixel + ivec2(0, stride), z, here));
  gl_PointSize = clamp(1.15 * max(width, min(gap, 5.0 * width)), 1.0, 48.0);
  float value = source == 1 ? z : deviation;
  float share = clamp((value - range.x) / max(range.y - range.x, 1e-9), 0.0, 1.0);
  colour = source == 0
    ? texture(picture, (vec2(pixel) + 0.5) / vec2(size)).rgb
    : texelFetch(colours, ivec2(int(share * 255.0 + 0.5), 0), 0).rgb;
}`;

const CLOUD_PIXEL = `#version 300 es
precision mediump float;
in vec3 colour;
in float strength;
out vec4 pixel;
void main() { pixel = strength * vec4(colour, 1.0); }`;

const MARKS = `#version 300 es
precision highp float;
layout(location = 0) in vec4 place;
layout(location = 1) in vec4 tint;
uniform mat4 clip;
uniform float density;
out vec4 colour;
out float rim;
void main() {
  gl_Position = clip * vec4(place.xyz, 1.0);
  gl_Position.z -= 0.001 * gl_Position.w;
  gl_PointSize = place.w * density;
  colour = tint;
  rim = 1.0 - 2.6 / (place.w * density);
}`;

const MARKS_PIXEL = `#version 300 es
precision mediump float;
in vec4 colour;
in float rim;
uniform bool round;
out vec4 pixel;
void main() {
  float from = round ? length(gl_PointCoord - 0.5) * 2.0 : 0.0;
  if (from > 1.0) discard;
  float inside = round ? clamp((1.0 - from) * 1.1 / (1.0 - rim), 0.0, 1.0) : 1.0;
  pixel = inside * vec4(mix(0.2 * colour.rgb, colour.rgb, clamp(1.5 * inside - 0.6, 0.0, 1.0)), 1.0);
}`;

/** Stride of the rows and columns drawn. */
export const strideOf = (width: number, height: number): number => Math.ceil(Math.sqrt((width * height) / MOST));

export interface Look {
  readonly eye: Eye;
  readonly camera: Intrinsics;
  readonly source: 0 | 1 | 2;
  readonly colours: Table;
  readonly range: readonly [number, number];
  readonly cut: number;
  /** Relative standard deviation above which a pixel is drawn pale. */
  readonly measured: number;
  readonly density: number;
  /** Stride of the pixels drawn while the cloud moves, in both directions. */
  readonly thinning: number;
}

/** Eight numbers per mark: position, diameter on the screen, colour. */
export type Marks = Float32Array;

export class Renderer {
  private readonly cloud: WebGLProgram;
  private readonly marks: WebGLProgram;
  private readonly buffer: WebGLBuffer;
  private readonly none: WebGLVertexArrayObject;
  private readonly some: WebGLVertexArrayObject;
  private readonly textures: Record<"depths" | "deviations" | "picture" | "colours", WebGLTexture>;
  private size: [number, number] = [0, 0];
  private kept: { depth?: Float32Array; deviation?: Float32Array | null; picture?: ImageBitmap | null; colours?: Table } = {};

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.cloud = program(gl, CLOUD, CLOUD_PIXEL);
    this.marks = program(gl, MARKS, MARKS_PIXEL);
    this.buffer = gl.createBuffer()!;
    this.none = gl.createVertexArray()!;
    this.some = gl.createVertexArray()!;
    gl.bindVertexArray(this.some);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    for (const location of [0, 1]) {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 4, gl.FLOAT, false, 32, 16 * location);
    }
    const texture = () => gl.createTexture()!;
    this.textures = { depths: texture(), deviations: texture(), picture: texture(), colours: texture() };
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.useProgram(this.cloud);
    ["depths", "deviations", "picture", "colours"].forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(this.cloud, name), unit));
  }

  /** Uploads the maps to draw, except those that have not changed. */
  load(width: number, height: number, depth: Float32Array, deviation: Float32Array | null, picture: ImageBitmap | null): void {
    const { gl } = this;
    if (this.size[0] !== width || this.size[1] !== height) this.kept = {};
    this.size = [width, height];
    const map = (texture: WebGLTexture, w: number, h: number, values: Float32Array) => {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      exact(gl);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, w, h, 0, gl.RED, gl.FLOAT, values);
    };
    if (this.kept.depth !== depth) map(this.textures.depths, width, height, depth);
    if (this.kept.deviation !== deviation) {
      map(this.textures.deviations, width, height, deviation ?? new Float32Array(width * height));
    }
    if (this.kept.picture !== picture) {
      gl.bindTexture(gl.TEXTURE_2D, this.textures.picture);
      exact(gl);
      if (picture) gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
      else gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, Uint8Array.of(160, 160, 160, 255));
    }
    Object.assign(this.kept, { depth, deviation, picture });
  }

  draw(look: Look, points: Marks, lines: Marks): void {
    const { gl } = this;
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const [width, height] = this.size;
    if (width === 0) return;
    if (this.kept.colours !== look.colours) {
      gl.bindTexture(gl.TEXTURE_2D, this.textures.colours);
      exact(gl);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(look.colours.buffer));
      this.kept.colours = look.colours;
    }
    Object.values(this.textures).forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.activeTexture(gl.TEXTURE0);
    const stride = look.thinning * strideOf(width, height);
    const columns = Math.ceil(width / stride);
    gl.useProgram(this.cloud);
    const at = (name: string) => gl.getUniformLocation(this.cloud, name);
    const { fx, fy, cx, cy } = look.camera;
    gl.uniformMatrix4fv(at("clip"), false, look.eye.clip);
    gl.uniform4f(at("camera"), fx, fy, cx, cy);
    gl.uniform2i(at("size"), width, height);
    gl.uniform1i(at("stride"), stride);
    gl.uniform1i(at("columns"), columns);
    gl.uniform1i(at("source"), look.source);
    gl.uniform2f(at("range"), ...look.range);
    gl.uniform2f(at("view"), gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.uniform1f(at("cut"), look.cut);
    gl.uniform1f(at("measured"), look.measured);
    gl.uniform1f(at("focal"), look.eye.focal);
    gl.bindVertexArray(this.none);
    gl.drawArrays(gl.POINTS, 0, columns * Math.ceil(height / stride));

    gl.useProgram(this.marks);
    gl.enable(gl.BLEND);
    gl.uniformMatrix4fv(gl.getUniformLocation(this.marks, "clip"), false, look.eye.clip);
    gl.uniform1f(gl.getUniformLocation(this.marks, "density"), look.density);
    gl.bindVertexArray(this.some);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    for (const [values, mode, round] of [[lines, gl.LINES, 0], [points, gl.POINTS, 1]] as const) {
      if (values.length === 0) continue;
      gl.uniform1i(gl.getUniformLocation(this.marks, "round"), round);
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
      gl.drawArrays(mode, 0, values.length / 8);
    }
    gl.disable(gl.BLEND);
  }
}

function exact(gl: WebGL2RenderingContext): void {
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
}

function program(gl: WebGL2RenderingContext, vertex: string, fragment: string): WebGLProgram {
  const made = gl.createProgram()!;
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]] as const) {
    const shader = gl.createShader(kind)!;
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? "a shader does not compile");
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) ?? "shaders do not link");
  return made;
}
