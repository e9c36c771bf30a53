import assert from "node:assert/strict";
import { test } from "node:test";
import { labels, median, metres, quantiles, rootMeanSquare, tick, ticks, withSign } from "../../src/model/numbers.ts";
import { ORBIT } from "../../src/model/settings.ts";
import { Frame } from "../../src/views/frame.ts";
import { numbers, ordered, paired } from "../../src/views/gallery.ts";
import { eye, nearer, projected, shifted, turned } from "../../src/views/matrix.ts";

test("lengths have three figures, a unit and a true minus", () => {
  assert.deepEqual([2.31449, 0.0824, 12.3456, 123.456, 0, null, NaN].map(metres), ["2.314 m", "0.0824 m", "12.35 m", "123.5 m", "0.000 m", "–", "–"]);
  assert.deepEqual([0.5, -0.5, -0.00001, 0.00001, null].map(withSign), ["+0.500", "−0.500", "0.0000", "0.0000", "–"]);
});

test("ticks are round and inside", () => {
  assert.deepEqual(ticks(2.18, 7.29, 6), [3, 4, 5, 6, 7]);
  assert.deepEqual(ticks(-0.25, 0.25, 5).map((value, _, all) => tick(value, all)), ["−0.2", "−0.1", "0.0", "0.1", "0.2"]);
  assert.deepEqual(ticks(3, 3, 4), [3]);
});

test("quantiles and root mean squares", () => {
  assert.deepEqual(quantiles([5, 1, NaN, 3, 2, 4], [0, 0.5, 1]), [1, 3, 5]);
  assert.equal(rootMeanSquare([3, 4]), Math.sqrt(12.5));
  assert.equal(rootMeanSquare([]), null);
});

test("the median is that of all values", () => {
  // Distinct values in pseudorandom order; then values that are ignored are added.
  const values = Float32Array.from({ length: 100_000 }, (_, i) => (((i + 1) * 7919) % 100_003) / 1000);
  const sorted = [...values].sort((a, b) => a - b);
  assert.equal(median(values), sorted[50_000]);
  assert.equal(median(values.subarray(1)), [...values.subarray(1)].sort((a, b) => a - b)[49_999]);
  const more = new Float32Array(300_000).fill(NaN);
  more.set(values);
  more.set([0, -1, Infinity, -Infinity], 200_000);
  assert.equal(median(more), sorted[50_000]);
  assert.equal(median(new Float32Array(10)), NaN);
});

test("labels do not touch each other", () => {
  const measure = (text: string) => 6 * text.length;
  for (const width of [60, 100, 150, 194, 240, 500]) {
    for (const [low, high] of [[-0.0174, 0.0174], [2.18, 7.29], [0, 0.0044], [-123.4, 250]] as const) {
      const found = labels(low, high, width, measure);
      assert.ok(found.length > 0);
      found.forEach(({ text, left }, i) => {
        assert.ok(left >= 0 && left + measure(text) <= width + 1e-9, `${text} at ${width}`);
        if (i > 0) assert.ok(left >= found[i - 1]!.left + measure(found[i - 1]!.text) + 6, `${found.map((label) => label.text)} at ${width}`);
      });
    }
  }
  assert.deepEqual(labels(0, 1, 300, measure).map(({ text }) => text), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
});

const STRAIGHT = { ...ORBIT, yaw: 0, pitch: 0, distance: 1, x: 0, y: 0, z: 0 };

test("without a turn, the eye sees what the camera saw", () => {
  // A camera of focal length 100 and 80 rows: tangent 0.4.
  const seen = eye(STRAIGHT, 4, 0.4, 400, 320);
  for (const [u, v, z] of [[0, 0, 2], [30, -20, 3], [-50, 40, 9]] as const) {
    const [x, y] = projected(seen, [(u / 100) * z, (v / 100) * z, z], 400, 320)!;
    assert.ok(Math.abs(x - (200 + 4 * u)) < 1e-3 && Math.abs(y - (160 + 4 * v)) < 1e-3, `${x} ${y}`);
  }
  assert.equal(projected(seen, [0, 0, -1], 400, 320), null);
});

test("the target stays in the middle, however it is turned", () => {
  for (const [yaw, pitch] of [[0.5, 0.3], [-2, -1], [3, 1.5]] as const) {
    const [x, y] = projected(eye({ ...STRAIGHT, yaw, pitch, distance: 2 }, 4, 0.5, 300, 200), [0, 0, 4], 300, 200)!;
    assert.ok(Math.abs(x - 150) < 1e-3 && Math.abs(y - 100) < 1e-3);
  }
});

test("drags take the near side along", () => {
  const near = [0, 0, 3] as const;
  const place = (orbit: typeof STRAIGHT, point: readonly [number, number, number]) => projected(eye(orbit, 4, 0.5, 300, 200), point, 300, 200)!;
  assert.ok(place(turned(STRAIGHT, 0.1, 0), near)[0] > 151);
  assert.ok(place(turned(STRAIGHT, 0, 0.1), near)[1] > 101);
  // A pan moves the target with the pointer at any rotation.
  for (const orbit of [STRAIGHT, { ...STRAIGHT, yaw: 0.7, pitch: -0.4 }]) {
    const [x, y] = place(shifted(orbit, 0.1, 0.05, 0.5), [0, 0, 4]);
    assert.ok(Math.abs(x - 170) < 0.1 && Math.abs(y - 110) < 0.1, `${x} ${y}`);
  }
  assert.equal(nearer(STRAIGHT, 2).distance, 0.5);
});

test("pixels and places on the stage are inverse, also magnified", () => {
  const frame = new Frame();
  frame.resize(490, 380, 304, 228);
  frame.magnify(3, 200, 150);
  const at = frame.pixel(200, 150);
  assert.ok(Math.abs(frame.x(at.u) - 200) < 1e-9 && Math.abs(frame.y(at.v) - 150) < 1e-9);
  frame.magnify(0.01, 200, 150);
  assert.ok(!frame.magnified);
  const [left, top, width, height] = frame.box();
  assert.ok(Math.abs(2 * left + width - 490) < 1e-9 && Math.abs(2 * top + height - 380) < 1e-9);
});

test("an error and a standard deviation are two numbers", () => {
  assert.deepEqual(numbers({ id: "1", error: 0.238, error_kind: "RMSE", standard_deviation: 0.0912 }), [["RMSE", "0.238 m"], ["σ", "0.0912 m"]]);
  assert.deepEqual(numbers({ id: "1", standard_deviation: 0.0912 }), [["σ", "0.0912 m"]]);
  assert.deepEqual([numbers(null), numbers({ id: "1", failure: "no points" })], [[], []]);
});

test("frames of two runs are paired and ordered", () => {
  const a = { name: "a", frames: [{ id: "2", error: 0.5 }, { id: "10", error: 0.1, standard_deviation: 3 }, { id: "1", failure: "no points" }] };
  const b = { name: "b", frames: [{ id: "10", error: 0.9 }, { id: "3", error: 0.2 }] };
  const pairs = paired(a, b);
  const ids = (order: Parameters<typeof ordered>[1]) => ordered(pairs, order).map(({ id }) => id);
  assert.deepEqual(ids("name"), ["1", "2", "3", "10"]);
  assert.deepEqual(ids("error"), ["10", "2", "3", "1"]);
  assert.deepEqual(ids("deviation")[0], "10");
  assert.deepEqual(ids("failure")[0], "1");
  assert.deepEqual(ids("change")[0], "10");
});
