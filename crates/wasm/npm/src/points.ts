// Conversion of sparse depths to the module's format.

import { LsdcError } from "./error.ts";

/** Column and row in pixels from the centre of the first pixel, depth along the optical axis, optionally standard deviation. */
export type Row = readonly [u: number, v: number, depth: number, sigma?: number];

/** Consecutive rows of three or four numbers (`columns`), or an array of rows. */
export type Points = Float32Array | Float64Array | readonly Row[];

/** Numbers of a row: column, row, depth, standard deviation (NaN if unknown). */
const WIDTH = 4;

/** Returns rows of four numbers. */
export function rows(points: Points, columns: 3 | 4 = 3): Float64Array {
  if (columns !== 3 && columns !== 4) {
    throw new LsdcError("use", `points have 3 or 4 columns, not ${String(columns)}`, "they are u, v, depth and, if it is known, sigma");
  }
  if (points instanceof Float32Array || points instanceof Float64Array) return spread(points, columns);
  if (!Array.isArray(points)) {
    throw new LsdcError("use", "points are neither a Float32Array, a Float64Array nor an array of rows");
  }
  const table = new Float64Array(WIDTH * points.length).fill(NaN);
  (points as readonly Row[]).forEach((row, i) => {
    if (!Array.isArray(row) || row.length < 3 || row.length > WIDTH) {
      throw new LsdcError("use", `point ${i} is no row of 3 or 4 numbers`, "they are u, v, depth and, if it is known, sigma");
    }
    row.forEach((value, k) => (table[WIDTH * i + k] = value ?? NaN));
  });
  return table;
}

function spread(points: Float32Array | Float64Array, columns: number): Float64Array {
  if (points.length % columns !== 0) {
    const hint = "give `columns: 4` if rows are u, v, depth and sigma, `columns: 3` if they are u, v and depth";
    throw new LsdcError("use", `${points.length} numbers are no rows of ${columns}`, hint);
  }
  const table = new Float64Array(WIDTH * (points.length / columns)).fill(NaN);
  for (let from = 0, to = 0; from < points.length; from += columns, to += WIDTH) {
    table.set(points.subarray(from, from + columns), to);
  }
  return table;
}
