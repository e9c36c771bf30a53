import assert from "node:assert/strict";
import { test } from "node:test";
import { assumed } from "../../src/model/camera.ts";
import { withoutEdges } from "../../src/model/edges.ts";
import { renewed, VIEW } from "../../src/model/settings.ts";

const CAMERA = { fx: 500, fy: 500, cx: 0, cy: 0 };

test("an assumed camera sees the width of the image under its field of view", () => {
  const { fx, fy, cx, cy } = assumed({ width: 304, height: 228 }, 60);
  assert.ok(Math.abs((2 * Math.atan(152 / fx) * 180) / Math.PI - 60) < 1e-9);
  assert.deepEqual([fy, cx, cy], [fx, 151.5, 113.5]);
});

test("flying pixels are left out, and slanted surfaces are not", () => {
  // A wall at 2 m, one at 4 m, and a pixel between them; a row without depth below.
  const row = [2, 2, 2, 3, 4, 4, 4];
  const map = Float32Array.from([...row, ...row, 0, 0, 0, 0, 0, 0, 0]);
  const { depth, left } = withoutEdges(map, 7, 3, CAMERA);
  assert.deepEqual([...depth.slice(0, 7)], [2, 2, 0, 0, 0, 4, 4]);
  assert.deepEqual([...depth.slice(7, 14)], [2, 2, 0, 0, 0, 4, 4]);
  assert.equal(left, 6);

  // A floor 1.2 m below the camera, seen at atan(1.2 / depth): 5 degrees are at 13.7 m.
  const rows = Array.from({ length: 400 }, (_, i) => (1.2 * CAMERA.fy) / (i + 30));
  const floor = withoutEdges(Float32Array.from(rows), 1, 400, CAMERA);
  const far = rows.filter((_, i) => floor.depth[i] === 0);
  assert.ok(far.every((depth) => depth > 13.2) && rows.every((depth, i) => depth < 14.2 || floor.depth[i] === 0));
  assert.equal(floor.left, far.length);
});

test("twice the pixels of the same surface are left out or kept alike", () => {
  const across = (many: number, fx: number) =>
    withoutEdges(Float32Array.from({ length: many }, (_, i) => 2 + (i / many) * 0.5), many, 1, { ...CAMERA, fx }).left;
  // Half a metre in depth over a tenth of a metre across is seen at 11 degrees; over a fiftieth, at 2.
  assert.equal(across(50, 1000), 0);
  assert.equal(across(100, 2000), 0);
  assert.equal(across(10, 1000), 10);
  assert.equal(across(20, 2000), 20);
});

test("another image has a cut and a view of its own", () => {
  const orbit = { ...VIEW.orbit, yaw: 2 };
  const view = { ...VIEW, cut: 0.04, edges: false, orbit, low: 1, high: 2, field: 90, theme: "dark", layer: "deviation", opacity: 0.5 } as const;
  assert.deepEqual(renewed(view), { ...VIEW, theme: "dark", layer: "deviation", opacity: 0.5 });
});
