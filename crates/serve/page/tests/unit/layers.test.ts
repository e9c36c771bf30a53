import assert from "node:assert/strict";
import { test } from "node:test";
import { decoded, LayersError } from "../../src/model/layers.ts";
import { read } from "../../src/model/npy.ts";

function answer(header: object, values: number[]): ArrayBuffer {
  let text = JSON.stringify(header);
  text += " ".repeat((4 - (Buffer.byteLength(text) % 4)) % 4);
  const bytes = Buffer.alloc(4 + Buffer.byteLength(text) + 4 * values.length);
  bytes.writeUInt32LE(Buffer.byteLength(text), 0);
  bytes.write(text, 4);
  values.forEach((value, i) => bytes.writeFloatLE(value, bytes.length - 4 * (values.length - i)));
  return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
}

const DEPTH = { name: "depth", offset: 0, length: 24 };
const DEVIATION = { name: "standard_deviation", offset: 24, length: 24 };

test("both maps, points and report", () => {
  const point = { index: 2, u: 1.5, v: 0, depth: 2, residual: 0.25, leave_one_out: -0.5, standard_deviation: 0.1, outlier: 0.75 };
  const header = { width: 3, height: 2, layers: [DEPTH, DEVIATION], points: [point, { u: 0, v: 1, depth: 3, residual: null, outlier: false }], report: { fit: { residual: 0.25 } } };
  const layers = decoded(answer(header, [1, 2, 3, 4, 5, 6, 0.5, 0.25, 0.125, 1, 2, 4]));
  assert.deepEqual([...layers.depth], [1, 2, 3, 4, 5, 6]);
  assert.deepEqual([...layers.deviation!], [0.5, 0.25, 0.125, 1, 2, 4]);
  assert.deepEqual(layers.points[0], { index: 2, u: 1.5, v: 0, depth: 2, sigma: null, residual: 0.25, leaveOneOut: -0.5, deviation: 0.1, outlier: 0.75 });
  assert.deepEqual([layers.points[1]!.index, layers.points[1]!.residual, layers.points[1]!.outlier], [1, null, 0]);
  assert.equal(layers.report.fit?.residual, 0.25);
});

test("without deviations, and with names that are not ASCII", () => {
  const layers = decoded(answer({ width: 3, height: 2, layers: [DEPTH], points: [], report: { image: "Küche 🍳" } }, [1, 2, 3, 4, 5, 6]));
  assert.equal(layers.deviation, null);
  assert.equal(layers.depth[5], 6);
});

test("what is damaged is refused with a reason", () => {
  const good = answer({ width: 3, height: 2, layers: [DEPTH], points: [], report: {} }, [1, 2, 3, 4, 5, 6]);
  const cases: [ArrayBuffer, RegExp][] = [
    [new ArrayBuffer(3), /four bytes/],
    [good.slice(0, good.byteLength - 4), /another size/],
    [good.slice(0, 20), /does not fit/],
    [answer({ width: 3, height: 2, layers: [] }, []), /without depth/],
    [answer({ layers: [DEPTH] }, [1, 2, 3, 4, 5, 6]), /without a size/],
    [answer({ width: 4, height: 2, layers: [DEPTH] }, [1, 2, 3, 4, 5, 6, 7, 8]), /another size/],
  ];
  for (const [bytes, reason] of cases) {
    assert.throws(() => decoded(bytes), (error) => error instanceof LayersError && reason.test(error.message));
  }
});

// numpy.save of [[1, 2, 3], [4, 5, 6]].
const npy = (type: string, shape: string, values: Buffer) => {
  const header = `{'descr': '${type}', 'fortran_order': False, 'shape': ${shape}, }`.padEnd(117) + "\n";
  const bytes = Buffer.concat([Buffer.from([0x93]), Buffer.from("NUMPY"), Buffer.from([1, 0, 118, 0]), Buffer.from(header), values]);
  return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length) as ArrayBuffer;
};

test("maps of NumPy, in both precisions", () => {
  const single = Buffer.from(Float32Array.from([1, 2, 3, 4, 5, 6]).buffer);
  const double = Buffer.from(Float64Array.from([1, 2, 3, 4, 5, 6]).buffer);
  for (const bytes of [npy("<f4", "(2, 3)", single), npy("<f8", "(2, 3, )", double)]) {
    const map = read(bytes);
    assert.deepEqual([map?.width, map?.height, [...(map?.values ?? [])]], [3, 2, [1, 2, 3, 4, 5, 6]]);
  }
  assert.equal(read(npy("<f4", "(6,)", single)), null);
  assert.equal(read(npy("<u2", "(2, 3)", single)), null);
  assert.equal(read(npy("<f4", "(2, 4)", single)), null);
  assert.equal(read(new ArrayBuffer(4)), null);
});
