import assert from "node:assert/strict";
import { test } from "node:test";
import { assumed } from "../../src/model/camera.ts";
import { flyingPixels } from "../../src/model/flying.ts";
import { renewed, VIEW } from "../../src/model/settings.ts";

test("an assumed camera sees the width of the image under its field of view", () => {
  const { fx, fy, cx, cy } = assumed({ width: 304, height: 228 }, 60);
  assert.ok(Math.abs((2 * Math.atan(152 / fx) * 180) / Math.PI - 60) < 1e-9);
  assert.deepEqual([fy, cx, cy], [fx, 151.5, 113.5]);
});

const [WIDTH, HEIGHT] = [80, 60];
const CAMERA = { fx: 400, fy: 400, cx: 0, cy: 0 };

/** Columns and rows of the flying pixels of a map. */
function flying(depth: (x: number, y: number) => number): [number, number][] {
  const map = Float32Array.from({ length: WIDTH * HEIGHT }, (_, i) => depth(i % WIDTH, Math.floor(i / WIDTH)));
  return [...flyingPixels(map, WIDTH, HEIGHT, CAMERA)].flatMap((flies, i) => (flies ? [[i % WIDTH, Math.floor(i / WIDTH)]] : []));
}

test("a ramp between two walls flies, and the walls do not", () => {
  // A linear ramp from 2 m to 4 m over some pixels.
  for (const width of [3, 6, 9]) {
    const share = (x: number) => Math.min(1, Math.max(0, (x - 40) / width + 0.5));
    for (const [name, found] of [
      ["column", flying((x) => 2 + 2 * share(x)).map(([x]) => x)],
      ["row", flying((_, y) => 2 + 2 * share(y + 10)).map(([, y]) => y + 10)],
    ] as const) {
      for (let at = 12; at < 68; at++) {
        const count = found.filter((place) => place === at).length;
        const across = name === "row" ? WIDTH : HEIGHT;
        if (share(at) > 0.1 && share(at) < 0.9) assert.equal(count, across, `${name} ${at} of a ramp of ${width}`);
        else if (share(at) === 0 || share(at) === 1) assert.ok(Math.abs(at - 40) < width / 2 + 1.5 || count === 0, `${name} ${at} of a wall`);
      }
    }
  }
});

test("of a large map, only what is drawn is looked at", () => {
  const map = Float32Array.from({ length: WIDTH * HEIGHT }, (_, i) => 2 + 2 * Math.min(1, Math.max(0, ((i % WIDTH) - 36) / 9)));
  const [all, some] = [1, 3].map((stride) => flyingPixels(map, WIDTH, HEIGHT, CAMERA, stride));
  assert.ok(all!.some((flies) => flies));
  all!.forEach((flies, i) => {
    const [x, y] = [i % WIDTH, Math.floor(i / WIDTH)];
    assert.equal(some![i], x % 3 === 0 && y % 3 === 0 ? flies : 0, `${x} ${y}`);
  });
});

test("planes seen from the side do not fly, nor sharp edges, nor what has no depth beside it", () => {
  // A floor 0.3 m below the camera, up to 24 m away: seen at 89.3 degrees.
  assert.deepEqual(flying((_, y) => (0.3 * CAMERA.fy) / (y + 5)), []);
  assert.deepEqual(flying((x) => (x < 40 ? 2 : 4)), []);
  assert.deepEqual(flying((x) => (x === 40 ? 3 : 0)), []);
});

test("another image has a cut and a view of its own", () => {
  const orbit = { ...VIEW.orbit, yaw: 2 };
  const view = { ...VIEW, cut: 0.04, flying: true, unmeasured: true, orbit, low: 1, high: 2, field: 90, theme: "dark", layer: "deviation", opacity: 0.5 } as const;
  assert.deepEqual(renewed(view), { ...VIEW, theme: "dark", layer: "deviation", opacity: 0.5 });
});
