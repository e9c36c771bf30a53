import assert from "node:assert/strict";
import { test } from "node:test";
import { DRAFT, VIEW } from "../../src/model/settings.ts";
import type { State } from "../../src/state.ts";
import { command } from "../../src/views/downloads.ts";

const given = [{ u: 1, v: 2, depth: 3 }];
const scene = {
  id: "", name: "my view.jpg", width: 640, height: 480, picture: null, file: null, camera: null, cameraFile: null,
  source: { demo: "" }, given, pointsName: "points.csv", remarks: [],
};
const text = (change: object = {}, view: object = {}) =>
  command({ scene: { ...scene, ...change }, draft: { ...DRAFT, points: given }, view: { ...VIEW, ...view } } as unknown as State).text;

test("the command is that of the map", () => {
  assert.equal(text(), "lsdc complete 'my view.jpg' points.csv");
});

test("a cloud has the camera that the page assumes", () => {
  // 640 / 2 / tan(30 degrees), and the middle of the image.
  assert.equal(text({}, { cut: 0.0441 }),
    "lsdc complete 'my view.jpg' points.csv --camera 554.256,554.256,319.5,239.5 --max-sigma 0.0441 --formats ply");
  assert.match(text({}, { cut: 0.1, flying: true }), / --keep-flying$/);
  assert.match(text({}, { cut: 0.1, unmeasured: true }), / --max-relative-sigma 1e6$/);
  assert.match(text({}, { cut: 0.1, field: 90 }), /--camera 320,320,319\.5,239\.5 /);
});

test("a camera that was opened is named, which points in space need too", () => {
  const camera = { camera: { fx: 1, fy: 1, cx: 0, cy: 0 }, cameraFile: { name: "my camera.toml" }, pointsName: "scan.ply" };
  assert.equal(text(camera), "lsdc complete 'my view.jpg' scan.ply --camera 'my camera.toml'");
  assert.match(text(camera, { cut: 0.1 }), / --camera 'my camera\.toml' --max-sigma 0\.1 /);
});
