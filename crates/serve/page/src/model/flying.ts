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
 */
export function flyingPixels(depth: Float32Array, width: number, height: number, { fx, fy }: Intrinsics): Uint8Array {
  const inverse = depth.map((metres) => (metres > 0 ? 1 / metres : 0));
  const flying = new Uint8Array(depth.length);
  for (const [right, down] of DIRECTIONS) {
    const angle = Math.hypot(right / fx, down / fy);
    const reach = Math.max(LEAST, Math.round(REACH / angle));
    const step = down * width + right;
    /** The change per pixel at the end of the way to one side, as far as there are depths. */
    const surface = (x: number, y: number, side: number): number => {
      const at = (steps: number) => inverse[y * width + x + side * steps * step]!;
      const inside = (way: number, at: number, size: number) => (way > 0 ? size - 1 - at : way < 0 ? at : reach);
      const room = Math.min(reach, inside(side * right, x, width), inside(side * down, y, height));
      let last = 0;
      while (last < room && at(last + 1) > 0) last++;
      const first = last - Math.min(last, Math.max(1, Math.floor(last / SURFACE)));
      return Math.abs(at(last) - at(first)) / Math.max(1, last - first);
    };
    for (let y = down === 0 ? 0 : 1; y < (down === 0 ? height : height - 1); y++) {
      for (let x = right; x < width - right; x++) {
        const i = y * width + x;
        const [before, own, after] = [inverse[i - step]!, inverse[i]!, inverse[i + step]!];
        const slope = 0.5 * Math.abs(after - before);
        if (!(slope > GRAZING * own * angle) || !(before > 0 && own > 0 && after > 0)) continue;
        const share = (own - before) / (after - before);
        if (share < BETWEEN || share > 1 - BETWEEN) continue;
        if (surface(x, y, -1) < FLAT * slope && surface(x, y, 1) < FLAT * slope) flying[i] = 1;
      }
    }
  }
  return flying;
}
