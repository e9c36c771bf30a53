import assert from "node:assert/strict";
import { test } from "node:test";
import { csv, packed, sampled, subset, unpacked, type Point } from "../../src/model/points.ts";

const points = (many: number): Point[] => Array.from({ length: many }, (_, i) => ({ u: i, v: 2 * i, depth: 1 + i }));
const chosen = (used: boolean[]) => used.flatMap((one, i) => (one ? [i] : []));

test("subsets have their size, are nested, and are spread", () => {
  const all = points(1000);
  let before = new Set<number>();
  for (const count of [1, 10, 100, 500, 999]) {
    const now = new Set(chosen(subset(all, count)));
    assert.equal(now.size, count);
    assert.ok([...before].every((i) => now.has(i)));
    before = now;
  }
  const halves = chosen(subset(all, 200)).filter((i) => i < 500).length;
  assert.ok(halves > 75 && halves < 125, String(halves));
  assert.ok(subset(all, null).every(Boolean) && subset(all, 5000).every(Boolean));
});

test("points placed by hand are always used, and later points change no choice", () => {
  const all = points(50);
  const more = [...all, { u: 1, v: 1, depth: 1, placed: true }];
  assert.deepEqual(chosen(subset(more, 8)), [...chosen(subset(all, 7)), 50]);
});

test("packed points come back as float32, others are refused", () => {
  const some: Point[] = [{ u: 1.5, v: 200.25, depth: 3.125 }, { u: 0, v: 0, depth: 65.5, sigma: 0.25, placed: true }];
  assert.deepEqual(unpacked(packed(some)), some);
  assert.match(packed(points(100)), /^[\w-]*$/);
  assert.deepEqual(unpacked(""), []);
  for (const text of ["!", packed(some).slice(0, -3), packed([{ u: 1, v: 1, depth: -1 }]), packed([{ u: NaN, v: 1, depth: 1 }])]) {
    assert.equal(unpacked(text), null, text);
  }
});

test("tables name their columns", () => {
  assert.equal(csv([{ u: 1, v: 2, depth: 3.5 }]), "u,v,depth\n1,2,3.5\n");
  assert.equal(csv([{ u: 1, v: 2, depth: 3.5, sigma: 0.1 }]), "u,v,depth,sigma\n1,2,3.5,0.1\n");
});

test("between pixels, a plane is itself; beyond the border, the border counts", () => {
  const plane = Float32Array.from({ length: 12 }, (_, i) => 1 + 2 * (i % 4) + 3 * Math.floor(i / 4));
  for (const [u, v] of [[0, 0], [3, 2], [1.25, 0.5], [2.9, 1.1]] as const) {
    assert.ok(Math.abs(sampled(plane, 4, 3, u, v) - (1 + 2 * u + 3 * v)) < 1e-6);
  }
  assert.equal(sampled(plane, 4, 3, -5, 9), 7);
  assert.equal(sampled(Float32Array.of(4), 1, 1, 0, 0), 4);
});
