// Compares depths and standard deviations of the WebAssembly module with the golden ones, relative to the range of depths.
// LSDC_GOLDEN is a folder written by `cargo run --release -p lsdc-eval --example golden -- FOLDER`.
import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { Completer } from "lsdc";
import { npm } from "./support.mjs";

/** The tolerance of the instruction set `portable`, which also has no fused multiply-add. */
const TOLERANCE = 3e-5;
const [COLUMNS, ROWS] = [24, 18];

/** Reads the arrays of a safetensors file of 32-bit floats, by name. */
function tensors(path) {
  const bytes = readFileSync(path);
  const start = 8 + Number(bytes.readBigUInt64LE(0));
  const entries = Object.entries(JSON.parse(bytes.toString("utf8", 8, start))).filter(([name]) => name !== "__metadata__");
  const values = ([from, to]) => new Float32Array(Uint8Array.from(bytes.subarray(start + from, start + to)).buffer);
  return new Map(entries.map(([name, { data_offsets: offsets }]) => [name, values(offsets)]));
}

/** Returns the values at the centres of the cells of a grid. */
function grid(map, width, height) {
  const place = (i, of, length) => Math.floor(((2 * i + 1) * length) / (2 * of));
  return Array.from({ length: COLUMNS * ROWS }, (_, i) => {
    const [x, y] = [place(i % COLUMNS, COLUMNS, width), place(Math.floor(i / COLUMNS), ROWS, height)];
    return map[y * width + x];
  });
}

test("depths and deviations are the golden ones", async (context) => {
  const folder = process.env.LSDC_GOLDEN;
  assert.ok(folder, "LSDC_GOLDEN is not set: the folder of the example `golden`");
  const golden = tensors(join(npm, "../../weights/golden/depths.safetensors"));
  const names = readdirSync(folder).filter((name) => name.endsWith(".rgb")).map((name) => name.slice(0, -4));
  assert.equal(names.length, 12);
  const largest = { depth: 0, sigma: 0 };
  for (const weights of ["default", "small"]) {
    const completer = await Completer.load({ weights });
    for (const name of names) {
      const bytes = readFileSync(join(folder, `${name}.points`));
      const numbers = new Float64Array(Uint8Array.from(bytes).buffer);
      const [width, height, range] = numbers;
      const scene = completer.scene({ width, height, data: new Uint8Array(readFileSync(join(folder, `${name}.rgb`))) });
      const found = scene.complete(numbers.slice(3), { columns: 4, outliers: false });
      for (const [what, map] of [["depth", found.depth], ["sigma", found.deviations]]) {
        const expected = golden.get(`${weights}/${name}/${what}`);
        const apart = grid(map, width, height).map((value, i) => Math.abs(value - expected[i]) / range);
        largest[what] = Math.max(largest[what], ...apart);
      }
      scene.free();
    }
    completer.free();
  }
  context.diagnostic(`wasm32: depths ${largest.depth.toExponential(1)}, deviations ${largest.sigma.toExponential(1)}`);
  assert.ok(Math.max(largest.depth, largest.sigma) < TOLERANCE);
});
