// Flying pixels lie in empty space between the surfaces on both sides of a depth edge. Clouds of `lsdc complete` use the same
// definition.

import type { Intrinsics } from "../service.ts";

/** Tangent of the angle between viewing ray and normal above which a surface is at a grazing angle: 80 degrees. */
const GRAZING = 5.67;
/** Distance at which the surfaces on both sides are examined: radians, and the least number of pixels. */
const REACH = 0.03;
const LEAST = 4;
/** The slope of a surface is taken over the last 1 / SURFACE of that distance. */
const SURFACE = 4;
/** Largest change of inverse depth per pixel on a surface, relative to the change at the pixel. */
const FLAT = 0.7;
/** Least distance of a pixel from both neighbours in inverse depth, relative to the difference between them. */
const BETWEEN = 0.1;
/** Steps right and down, in pixels. */
const DIRECTIONS = [[1, 0], [0, 1], [1, 1], [1, -1]] as const;

/**
 * Returns 1 for each flying pixel, row by row. A pixel is flying if along a row, a column or a diagonal
 * - its inverse depth is between those of its two neighbours, at a grazing angle; and
 * - inverse depth changes less at a distance on both sides. It is linear on planes, so a slanted plane would continue.
 * Only every `stride`-th row and column is tested.
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
    /** Change of inverse depth per pixel at the far end on one side, or as far as there are depths. */
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
