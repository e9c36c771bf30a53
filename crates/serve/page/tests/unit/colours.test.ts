import assert from "node:assert/strict";
import { test } from "node:test";
import { css, index, paint, signed, table, type MapName } from "../../src/model/colours.ts";

const at = (name: MapName, i: number) => [...table(name).slice(4 * i, 4 * i + 3)];

test("maps are those of Matplotlib 3.10, up to 2 of 255", () => {
  const published: [MapName, number, number[]][] = [
    ["viridis", 0, [68, 1, 84]], ["viridis", 64, [59, 82, 139]], ["viridis", 128, [33, 145, 140]], ["viridis", 200, [112, 207, 87]], ["viridis", 255, [253, 231, 37]],
    ["magma", 0, [0, 0, 4]], ["magma", 64, [81, 18, 124]], ["magma", 128, [183, 55, 121]], ["magma", 200, [253, 152, 105]], ["magma", 255, [252, 253, 191]],
    ["turbo", 0, [48, 18, 59]], ["turbo", 64, [40, 188, 235]], ["turbo", 128, [164, 252, 60]], ["turbo", 200, [244, 102, 23]], ["turbo", 255, [122, 4, 3]],
  ];
  for (const [name, i, colour] of published) {
    at(name, i).forEach((value, channel) => assert.ok(Math.abs(value - colour[channel]!) <= 2, `${name} ${i}: ${at(name, i)}`));
  }
});

/** Lightness of CIE 1976, by IEC 61966-2-1 and CIE 15. */
function lightness([r, g, b]: readonly number[]): number {
  const linear = (value: number) => (value / 255 <= 0.04045 ? value / 255 / 12.92 : ((value / 255 + 0.055) / 1.055) ** 2.4);
  const y = 0.2126 * linear(r!) + 0.7152 * linear(g!) + 0.0722 * linear(b!);
  return y > 0.008856 ? 116 * Math.cbrt(y) - 16 : 903.3 * y;
}

test("viridis, magma and grey grow lighter at every step of eight", () => {
  for (const name of ["viridis", "magma", "grey"] as const) {
    for (let i = 8; i < 256; i += 8) assert.ok(lightness(at(name, i)) > lightness(at(name, i - 8)), `${name} ${i}`);
  }
});

test("signed errors of one size are equally light, and zero is the lightest", () => {
  const of = (i: number) => lightness([...signed().slice(4 * i, 4 * i + 3)]);
  for (let i = 0; i < 128; i += 16) assert.ok(Math.abs(of(i) - of(255 - i)) < 6, `${i}: ${of(i)}, ${of(255 - i)}`);
  assert.ok(of(128) > of(60) && of(60) > of(10));
});

test("values take their share of the table, and those beyond the ends", () => {
  assert.deepEqual([index(2, 2, 4), index(3, 2, 4), index(4, 2, 4), index(9, 2, 4), index(-1, 2, 4)], [0, 128, 255, 255, 0]);
  assert.equal(index(3, 3, 3), 128);
  assert.equal(css(table("grey"), 1, 0, 1), "rgb(250 250 250)");
});

test("painting agrees with the table value by value, and leaves out what is not finite", () => {
  const values = Float32Array.from([0, 0.25, 0.5, 1, 2, -1, NaN]);
  const pixels = new Uint8ClampedArray(4 * values.length);
  paint(values, table("viridis"), 0, 1, pixels);
  values.forEach((value, i) => {
    const got = [...pixels.slice(4 * i, 4 * i + 4)];
    assert.deepEqual(got, Number.isNaN(value) ? [0, 0, 0, 0] : [...at("viridis", index(value, 0, 1)), 255]);
  });
});
