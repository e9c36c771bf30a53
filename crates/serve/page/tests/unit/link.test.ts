import assert from "node:assert/strict";
import { test } from "node:test";
import { MOST_POINTS, read, written } from "../../src/model/link.ts";
import { FIT, VIEW, type Fit, type View } from "../../src/model/settings.ts";

const FULL: { fit: Fit; view: View } = {
  fit: { robust: "gm", fit: "lse", prior: "flat", sigma: 0.025 },
  view: {
    layer: "deviation", opacity: 0.4, marks: "outlier", marksOpacity: 0.75, colours: "turbo", low: 0.5, high: 8, cloud: "depth",
    flying: true, unmeasured: true, cut: 0.15, field: 71, orbit: { yaw: -1.25, pitch: 0.5, distance: 2, x: 0.1, y: -0.2, z: 0.3 }, theme: "dark",
  },
};

test("every setting makes the round trip", () => {
  const points = [{ u: 1, v: 2, depth: 3 }, { u: 4, v: 5, depth: 6.5, sigma: 0.5, placed: true }];
  const source = { file: "Küche & Bad=1.jpg", width: 640, height: 480 };
  const text = written({ ...FULL, source, count: 12, points });
  assert.deepEqual(read(`#${text}`), { ...FULL, source, count: 12, points, omitted: 0 });
});

test("defaults take no room", () => {
  const text = written({ source: { demo: "room" }, fit: FIT, view: VIEW, count: null, points: null });
  assert.equal(text, "demo=room");
  assert.deepEqual(read(text), { source: { demo: "room" }, fit: FIT, view: VIEW, count: null, points: null, omitted: 0 });
});

test("no robust loss is another setting than that of the weights", () => {
  const text = written({ source: null, fit: { ...FIT, robust: "none" }, view: VIEW, count: null, points: null });
  assert.equal(read(text).fit.robust, "none");
});

test("points beyond what a link holds are said to be missing", () => {
  const points = Array.from({ length: MOST_POINTS + 1 }, (_, i) => ({ u: i, v: 0, depth: 1 }));
  const linked = read(written({ source: null, fit: FIT, view: VIEW, count: null, points }));
  assert.deepEqual([linked.points, linked.omitted], [null, MOST_POINTS + 1]);
});

test("what cannot be read has no effect", () => {
  const linked = read("#robust=best&opacity=7&low=-1&colours=jet&orbit=1,2&count=x&points=!!&size=3&image=a&cut=&%E0%A4%A");
  assert.deepEqual(linked, { source: null, fit: FIT, view: VIEW, count: null, points: null, omitted: 0 });
});
