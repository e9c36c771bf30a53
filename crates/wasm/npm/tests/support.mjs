// The room of the repository, and the results of the native library: LSDC_REFERENCE is the folder written by
// `cargo run --release -p lsdc-c --example reference -- FOLDER`.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

export const npm = fileURLToPath(new URL("..", import.meta.url));
const room = join(npm, "../../../assets/room");
const reference = process.env.LSDC_REFERENCE;
if (!reference) throw new Error("LSDC_REFERENCE is not set: the folder of the example `reference` of lsdc-c");

/** Reads a NumPy array of 32-bit floats. */
function npy(path) {
  const bytes = readFileSync(path);
  const start = 10 + bytes.readUInt16LE(8);
  const [height, width] = /\((\d+),\s*(\d+),?\s*\)/.exec(bytes.toString("latin1", 10, start)).slice(1).map(Number);
  return { width, height, values: new Float32Array(Uint8Array.from(bytes.subarray(start)).buffer, 0, width * height) };
}

/** Returns the image, with three bytes per pixel. */
export function image() {
  const bytes = readFileSync(join(reference, "rgb.ppm"));
  const [header, width, height] = /^P6 (\d+) (\d+) 255\n/.exec(bytes.toString("latin1", 0, 32));
  return { width: Number(width), height: Number(height), data: new Uint8Array(bytes.subarray(header.length)) };
}

/** Returns rows of u, v and depth. */
export function points() {
  const { width, values } = npy(join(room, "sparse.npy"));
  const rows = [...values].flatMap((depth, i) => (depth > 0 ? [[i % width, Math.floor(i / width), depth]] : []));
  return Float32Array.from(rows.flat());
}

export const truth = () => npy(join(room, "depth.npy")).values;
export const native = (name) => npy(join(reference, `${name}.npy`)).values;

export function largestDifference(values, expected) {
  assert.equal(values.length, expected.length);
  return values.reduce((largest, value, i) => Math.max(largest, Math.abs(value - expected[i])), 0);
}

/** Root mean square of the differences to the known depths. */
export function rmse(values, expected) {
  const errors = [...values].flatMap((value, i) => (expected[i] > 0 ? [(value - expected[i]) ** 2] : []));
  return Math.sqrt(errors.reduce((sum, square) => sum + square, 0) / errors.length);
}
