import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { before, test } from "node:test";
import { pathToFileURL } from "node:url";
import { Completer, LsdcError } from "lsdc";
import { image, largestDifference, native, npm, points, rmse, truth } from "./support.mjs";

/** Of metres and standard deviations: instruction sets of the native library differ by at least 1e-5. */
const TOLERANCE = 1e-4;
const room = image();
const known = points();
let completer;
let scene;

before(async () => {
  completer = await Completer.load({ weights: "small" });
  scene = completer.scene(room);
});

/** Returns the error that a function throws. */
function thrown(work) {
  try {
    work();
  } catch (error) {
    assert.ok(error instanceof LsdcError, String(error));
    return error;
  }
  assert.fail("nothing was thrown");
}

async function rejected(promise) {
  const [result] = await Promise.allSettled([promise]);
  return thrown(() => {
    if (result.status === "rejected") throw result.reason;
  });
}

test("the module has no imports", async () => {
  const module = await WebAssembly.compile(readFileSync(join(npm, "dist/lsdc.wasm")));
  assert.deepEqual(WebAssembly.Module.imports(module), []);
});

test("depths and deviations are those of the native library", async () => {
  const completer = await Completer.load();
  const found = completer.scene(room).complete(known);
  assert.deepEqual([found.width, found.height], [304, 228]);
  assert.ok(largestDifference(found.depth, native("depth")) < TOLERANCE);
  assert.ok(largestDifference(found.deviations, native("deviation")) < TOLERANCE);
  const { report } = found;
  assert.deepEqual(report.points, { given: 500, used: 500, ignored: 0, outside: 0, without_deviation: 0 });
  assert.equal(report.fit.outliers, found.outliers.length);
  // The leave-one-out error predicts the true error.
  const error = rmse(found.depth, truth());
  assert.ok(Math.abs(report.fit.leave_one_out / error - 1) < 0.2, `${report.fit.leave_one_out} ${error}`);
  completer.free();
});

test("small weights are nearly as accurate", () => {
  const { depth } = scene.complete(known);
  assert.ok(rmse(depth, truth()) < 1.3 * rmse(native("depth"), truth()));
});

test("residuals are differences from the map at the points", () => {
  const { depth, residuals, leaveOneOut } = scene.complete(known);
  assert.equal(leaveOneOut.length, 500);
  residuals.forEach((residual, i) => {
    const [u, v, z] = known.subarray(3 * i);
    assert.ok(Math.abs(z - depth[304 * v + u] - residual) < TOLERANCE);
  });
});

test("twice the depths are twice the map", () => {
  const far = known.map((value, i) => (i % 3 === 2 ? 2 * value : value));
  const [one, two] = [known, far].map((points) => scene.complete(points, { deviations: false, outliers: false }).depth);
  assert.ok(largestDifference(two.map((value) => value / 2), one) < TOLERANCE);
});

test("all forms of points and pixels give the same depths", () => {
  const quick = { deviations: false, outliers: false };
  const { depth } = scene.complete(known, quick);
  const rows = Array.from({ length: 500 }, (_, i) => [...known.subarray(3 * i, 3 * i + 3)]);
  const wide = Float64Array.from(rows.flatMap((row) => [...row, NaN]));
  assert.deepEqual(scene.complete(rows, quick).depth, depth);
  assert.deepEqual(scene.complete(wide, { ...quick, columns: 4 }).depth, depth);
  const rgba = new Uint8ClampedArray(4 * 304 * 228).map((_, i) => (i % 4 === 3 ? 9 : room.data[3 * Math.floor(i / 4) + (i % 4)]));
  const other = completer.scene({ width: 304, height: 228, data: rgba });
  assert.deepEqual(other.complete(known, quick).depth, depth);
  other.free();
});

test("deviations of points and robust losses are used", () => {
  const quick = { deviations: false, outliers: true };
  const wrong = known.slice();
  wrong[2] += 3;
  const found = scene.complete(wrong, quick);
  assert.equal(found.outliers[0].index, 0);
  assert.ok(found.outliers[0].error > 2);
  assert.equal(found.deviations, null);
  const robust = scene.complete(wrong, { ...quick, robust: "auto" });
  assert.ok(robust.outliers[0].weight < 0.1 && found.outliers[0].weight === 1);
  const rows = Array.from({ length: 500 }, (_, i) => [...wrong.subarray(3 * i, 3 * i + 3), i === 0 ? 5 : 0.02]);
  assert.ok(scene.complete(rows, quick).residuals[0] > scene.complete(wrong, quick).residuals[0]);
  const some = rows.map((row, i) => (i % 2 ? row : row.slice(0, 3)));
  assert.equal(scene.complete(some, quick).report.points.without_deviation, 250);
  assert.equal(scene.complete(some, { ...quick, sigma: 0.02 }).report.points.without_deviation, 0);
  assert.equal(scene.complete(known, { fit: "lse", outliers: false }).report.fit.method, "lse");
});

test("points that cannot be used are counted", () => {
  const rows = [[10, 10, 2], [NaN, 10, 2], [10, 10, NaN], [20, 30, -1], [400, 10, 2], [200, 100, 3]];
  const { report, residuals, leaveOneOut } = scene.complete(rows);
  assert.deepEqual(report.points, { given: 6, used: 2, ignored: 3, outside: 1, without_deviation: 0 });
  assert.deepEqual([...residuals].map(Number.isNaN), [false, true, true, true, true, false]);
  assert.equal(leaveOneOut.length, 6);
});

test("no usable point is an error of the fit", () => {
  for (const rows of [[], [[NaN, NaN, NaN]], new Float32Array(3), [[-5, 3, 2]]]) {
    const error = thrown(() => scene.complete(rows));
    assert.equal(error.kind, "fit");
    assert.match(error.message, /no sparse depth to fit/);
    assert.match(error.hint, /at least one/);
  }
  // The scene can still be used.
  assert.equal(scene.complete(known, { outliers: false }).report.points.used, 500);
});

test("arguments that cannot be used are refused", async () => {
  const at = (width, height, length) => ({ width, height, data: new Uint8Array(length) });
  for (const wrong of [at(4, 2, 23), at(4, 2, 16), at(0, 2, 0), at(-1, -1, 1), at(2.5, 2, 5), at(NaN, 1, 3), { ...at(1, 1, 3), data: [1, 2, 3] }]) {
    assert.equal(thrown(() => completer.scene(wrong)).kind, "image");
  }
  const large = thrown(() => completer.scene(at(8193, 4096, 8193 * 4096)));
  assert.match(large.message, /8193x4096 pixels are more than/);
  assert.match(large.hint, /resize/);
  assert.equal(thrown(() => completer.scene(room, { quality: "superb" })).kind, "settings");
  assert.equal(thrown(() => scene.complete(new Float32Array(4))).kind, "use");
  assert.equal(thrown(() => scene.complete([[1, 2]])).kind, "use");
  assert.equal(thrown(() => scene.complete("1 2 3")).kind, "use");
  assert.equal(thrown(() => scene.complete(known, { columns: 5 })).kind, "use");
  assert.equal(thrown(() => scene.complete(known, { robust: "strong" })).kind, "settings");
  assert.match(thrown(() => scene.complete(known, { colour: 1 })).message, /colour/);
  for (const sigma of [-1, 0, NaN, Infinity, "0.1"]) assert.equal(thrown(() => scene.complete(known, { sigma })).kind, "settings");
  assert.equal((await rejected(Completer.load({ weights: "tiny" }))).kind, "settings");
  assert.equal((await rejected(Completer.load({ weights: new Uint8Array(100) }))).kind, "weights");
  const file = readFileSync(join(npm, "dist/weights/small.safetensors"));
  assert.equal((await rejected(Completer.load({ weights: file.subarray(0, file.length - 4) }))).kind, "weights");
  const missing = await rejected(Completer.load({ weights: pathToFileURL(join(npm, "missing.safetensors")) }));
  assert.equal(missing.kind, "load");
  assert.match(missing.hint, /missing\.safetensors/);
});

test("what was freed cannot be used", async () => {
  const other = completer.scene(room);
  other.free();
  other.free();
  assert.equal(thrown(() => other.complete(known)).kind, "use");
  const second = await Completer.load({ weights: new URL("../dist/weights/small.safetensors", import.meta.url) });
  const left = second.scene(room);
  second.free();
  left.free();
  assert.equal(thrown(() => left.complete(known)).kind, "use");
  assert.equal(thrown(() => second.scene(room)).kind, "use");
});

test("a trap stops the completer, and no other", async () => {
  const other = await Completer.load({ weights: "small" });
  const { instance } = other;
  // No input is known to stop the module.
  const message = new TextEncoder().encode("panicked at src/lib.rs: a message\0");
  instance.exports = {
    ...instance.exports,
    lsdc_scene() {
      new Uint8Array(instance.exports.memory.buffer).set(message, instance.message);
      throw new WebAssembly.RuntimeError("unreachable");
    },
  };
  for (let attempt = 0; attempt < 2; attempt++) {
    const error = thrown(() => other.scene(room));
    assert.equal(error.kind, "stopped");
    assert.match(error.message, /has stopped: panicked at src\/lib\.rs: a message$/);
    assert.match(error.hint, /load another completer/);
  }
  assert.equal(scene.complete(known, { outliers: false }).report.points.used, 500);
});

test("memory does not grow over 50 fits and 10 scenes", () => {
  const refit = (i) => scene.complete(known.subarray(0, 3 * (500 - (i % 7))), { deviations: i % 5 === 0, outliers: i % 5 === 0 });
  const rescene = () => {
    const other = completer.scene(room);
    other.complete(known, { outliers: false });
    other.free();
  };
  for (let i = 0; i < 5; i++) refit(i);
  for (let i = 0; i < 2; i++) rescene();
  const before = completer.memory;
  for (let i = 0; i < 50; i++) refit(i);
  for (let i = 0; i < 10; i++) rescene();
  assert.equal(completer.memory, before);
});
