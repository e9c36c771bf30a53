// Flying pixels: those that lie between the surfaces on both sides of a depth edge, where there is nothing. The definition is
// that of clouds of `lsdc complete`.

import type { Intrinsics } from "../service.ts";

/** The tangent of the angle between viewing ray and normal, from which on a surface is seen at a grazing angle: 80 degrees. */
const GRAZING = 5.67;
/** How far away the surfaces on both sides are looked at: radians of the view, and at least pixels. */
const REACH = 0.03;
const LEAST = 4;
/** The last part of that way is the surface. */
const SURFACE = 4;
/** The most that inverse depth changes on a surface, as a share of its change at the pixel. */
const FLAT = 0.7;
/** The least share of the way from one neighbour to the other by which a pixel lies between them. */
const BETWEEN = 0.1;
/** Pixels right and down. */
const DIRECTIONS = [[1, 0], [0, 1], [1, 1], [1, -1]] as const;

/**
 * 1 for each flying pixel, row by row. A pixel is one if along a row, a column or a diagonal
 * - its inverse depth is between those of its two neighbours, and the surface is seen at a grazing angle; and
 * - some way before and behind, inverse depth, which is linear on planes, changes less: a plane seen from the side goes on.
 * Of every `stride`-th row and column.
 */
export function flyingPixels(depth: Float32Array, width: number, height: number, { fx, fy }: Intrinsics, stride = 1): Uint8Array {
  const inverse = new Float32Array(depth.length);
  for (let i = 0; i < depth.length; i++) inverse[i] = depth[i]! > 0 ? 1 / depth[i]! : 0;
  const dense = !inverse.includes(0);
  const flying = new Uint8Array(depth.length);
  for (const [right, down] of DIRECTIONS) {
    const angle = Math.hypot(right / fx, down / fy);
    const reach = Math.max(LEAST, Math.round(REACH / angle));
    const step = down * width + right;
    const room = (way: number, at: number, size: number) => (way > 0 ? size - 1 - at : way < 0 ? at : reach);
    /** The change per pixel at the end of the way to one side, as far as there are depths. */
    const surface = (x: number, y: number, side: number): number => {
      const [from, by] = [y * width + x, side * step];
      let last = Math.min(reach, room(side * right, x, width), room(side * down, y, height));
      if (!dense) {
        const most = last;
        for (last = 0; last < most && inverse[from + (last + 1) * by]! > 0; ) last++;
      }
      const first = last - Math.min(last, Math.max(1, Math.floor(last / SURFACE)));
      return Math.abs(inverse[from + last * by]! - inverse[from + first * by]!) / Math.max(1, last - first);
    };
    const least = 2 * GRAZING * angle;
    for (let y = down === 0 ? 0 : stride; y < height - Math.abs(down); y += stride) {
      const end = y * width + width - right;
      for (let i = y * width + right * stride; i < end; i += stride) {
        const before = inverse[i - step]!;
        const after = inverse[i + step]!;
        const own = inverse[i]!;
        if (!(Math.abs(after - before) > least * own)) continue;
        const share = (own - before) / (after - before);
        if (share < BETWEEN || share > 1 - BETWEEN || before === 0 || own === 0 || after === 0) continue;
        const most = 0.5 * FLAT * Math.abs(after - before);
        const x = i - y * width;
        if (surface(x, y, -1) < most && surface(x, y, 1) < most) flying[i] = 1;
      }
    }
  }
  return flying;
}
