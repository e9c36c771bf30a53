import assert from "node:assert/strict";
import { test } from "node:test";
import * as png from "../../src/browser/png.ts";
import { read } from "../../src/browser/read.ts";
import { cloudPly, depthPng } from "../../src/browser/write.ts";
import { ServiceError } from "../../src/service.ts";

/** A file written by Pillow, whose rows use three filters. */
const PILLOW = "iVBORw0KGgoAAAANSUhEUgAAAAkAAAAHEAAAAACvYOT/AAAAbklEQVR4nGNkfsGkwwiHTDqMOowspiZfINCMx+SL8ReTLyyMz433pO3JvMK0h+GK8Z708swrDGxzFyha773qWHCXp3LpX8eZt2VZmKRNHzOvntN9IZgpxfQxy+o53YzcuUgGQyDfHmTjTb6YfAEAtZ4vBLyJ0/QAAAAASUVORK5CYII=";
const stored = (x: number, y: number): number => (1000 + 300 * x + 77 * y * y + ((x * y) % 5) * 13_000) % 65_536;
const SIZE = { width: 9, height: 7 };
const buffer = (bytes: Uint8Array): ArrayBuffer => Uint8Array.from(bytes).buffer;
const pillow = (): ArrayBuffer => buffer(Buffer.from(PILLOW, "base64"));

async function refusal(file: File): Promise<string> {
  const [result] = await Promise.allSettled([read(file, SIZE)]);
  assert.ok(result.status === "rejected" && result.reason instanceof ServiceError, "it is read");
  return result.reason.message;
}

test("16-bit PNGs of another program are read", async () => {
  const map = (await png.read(pillow()))!;
  assert.deepEqual([map.width, map.height, map.perMetre], [9, 7, null]);
  map.values.forEach((value, i) => assert.equal(value, stored(i % 9, Math.floor(i / 9))));
});

test("a 16-bit PNG that is damaged is none", async () => {
  for (const length of [0, 8, 32, 60, 120]) assert.equal(await png.read(pillow().slice(0, length)), null);
  const eight = new Uint8Array(pillow());
  eight[24] = 8;
  assert.equal(await png.read(eight.buffer), null);
});

test("depths are written in millimetres, or in the finest unit that holds them", async () => {
  const written = async (...depth: number[]) => {
    const layers = { width: depth.length, height: 1, depth: Float32Array.from(depth), deviation: null, points: [], report: {} };
    return png.read(await (await depthPng(layers)).arrayBuffer());
  };
  const [near, far] = [(await written(0.5, 65.5))!, (await written(0.5, 100))!];
  assert.deepEqual([near.perMetre, ...near.values], [1000, 500, 65_500]);
  assert.deepEqual([far.perMetre, ...far.values], [256, 128, 25_600]);
  await assert.rejects(written(1, 70_000), ServiceError);
});

test("tables are read by their columns", async () => {
  const table = async (text: string) => (await read(new File([text], "points.csv"), SIZE)).points;
  const expected = [{ u: 1, v: 2.5, depth: 3 }, { u: 4, v: 5, depth: 6, sigma: 0.1 }];
  assert.deepEqual(await table("u,v,depth,sigma\n1,2.5,3,\n4,5,6,0.1\n"), expected);
  assert.deepEqual(await table("# points\n1 2.5 3\r\n\r\n4\t5 6 0.1"), expected);
  assert.deepEqual(await table("depth;sigma;u;v\n3;nan;1;2.5\n6;0.1;4;5"), expected);
  assert.match(await refusal(new File(["x,y,z\n1,2,3\n"], "cloud.txt")), /columns x, y, z/);
  assert.match(await refusal(new File(["1,2,3\n4,5\n"], "short.csv")), /line 2/);
  assert.match(await refusal(new File(["1,2,3,4,5\n"], "long.csv")), /line 1/);
  assert.match(await refusal(new File(["1,2,three\n"], "word.csv")), /line 1/);
});

test("maps are points at their pixels, and say what was assumed", async () => {
  const { points, remarks } = await read(new File([pillow()], "depth.png"), SIZE);
  assert.equal(points.length, 63);
  assert.deepEqual(points[10], { u: 1, v: 1, depth: stored(1, 1) / 1000 });
  assert.match(remarks[0]!, /millimetres/);
  const file = await png.write({ ...SIZE, values: Uint16Array.from({ length: 63 }, (_, i) => [0, 65_535, 512][i % 3]!), perMetre: 256 });
  const marked = await read(new File([file], "marked.png"), SIZE);
  assert.equal(marked.points.length, 21);
  assert.ok(marked.points.every(({ depth }) => depth === 2));
  assert.deepEqual(marked.remarks, ["21 pixels are 65535, the largest number of 16 bits, and are left out"]);
  const [message, other] = [await refusal(new File(["P5"], "depth.pgm")), await read(new File([pillow()], "d.png"), { width: 9, height: 8 }).catch(String)];
  assert.match(message, /depth\.pgm/);
  assert.match(String(other), /9x7 pixels, but the image 9x8/);
});

test("an array of rows is a list of points", async () => {
  const header = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), }".padEnd(117) + "\n";
  const bytes = [Buffer.from("\x93NUMPY\x01\x00\x76\x00", "latin1"), Buffer.from(header), Buffer.from(Float64Array.of(1, 2, 3, 4, 5, 6).buffer)];
  const { points } = await read(new File(bytes, "rows.npy"), SIZE);
  assert.deepEqual(points, [{ u: 1, v: 2, depth: 3 }, { u: 4, v: 5, depth: 6 }]);
});

test("a cloud has the pixels below the cut, in the frame of the camera", async () => {
  const layers = { width: 2, height: 2, depth: Float32Array.of(1, 2, 3, 4), deviation: Float32Array.of(0.125, 0.5, 0.1, 0.1), points: [], report: {} };
  const colours = Uint8ClampedArray.from({ length: 16 }, (_, i) => 10 * i);
  const cloud = async (absolute: number, relative: number) => {
    const blob = cloudPly(layers, colours, { fx: 2, fy: 4, cx: 0.5, cy: 0.5 }, { absolute, relative, keepFlying: true });
    return Buffer.from(await blob.arrayBuffer());
  };
  // 0.125 m is an eighth of 1 m; 0.5 m is a quarter of 2 m.
  for (const [absolute, relative, count] of [[Infinity, Infinity, 4], [Infinity, 0.125, 3], [Infinity, 0.1, 2], [0.11, 0.2, 2]] as const)
    assert.match((await cloud(absolute, relative)).toString("latin1"), new RegExp(`element vertex ${count}\n`));
  const bytes = await cloud(0.3, 0.2);
  const start = bytes.indexOf("end_header\n") + 11;
  assert.match(bytes.toString("latin1", 0, start), /element vertex 3\n/);
  const last = start + 2 * 19;
  assert.equal(bytes.length, last + 19);
  assert.deepEqual([0, 4, 8].map((at) => bytes.readFloatLE(last + at)), [1, 0.5, 4]);
  assert.deepEqual([...bytes.subarray(last + 12, last + 15)], [120, 130, 140]);
});
