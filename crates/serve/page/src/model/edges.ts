// Flying pixels: at a jump of depth, maps have pixels between an object and what is behind it, where there is nothing.

import type { Intrinsics } from "../service.ts";

/** The least angle in degrees at which the surface between two neighbours may be seen; at less, it is taken for a jump. */
export const GRAZING = 5;

/**
 * The depths without those at jumps, which are 0, and how many these are. A pixel is left out if the surface from it to one
 * of its four neighbours is seen at less than the least angle: the depths differ by more than their distance across the
 * line of sight (depth over focal length), divided by the tangent of the angle. That does not depend on the size of the
 * image.
 */
export function withoutEdges(depth: Float32Array, width: number, height: number, { fx, fy }: Intrinsics): { depth: Float32Array; left: number } {
  const slope = 1 / Math.tan((GRAZING * Math.PI) / 180);
  const [across, down] = [slope / fx, slope / fy];
  const kept = depth.slice();
  let left = 0;
  const drop = (i: number) => {
    if (kept[i]! > 0) left++;
    kept[i] = 0;
  };
  const compare = (i: number, j: number, most: number) => {
    const [a, b] = [depth[i]!, depth[j]!];
    if (!(a > 0 && b > 0) || Math.abs(a - b) <= most * Math.min(a, b)) return;
    drop(i);
    drop(j);
  };
  for (let row = 0, i = 0; row < height; row++) {
    for (let column = 0; column < width; column++, i++) {
      if (column + 1 < width) compare(i, i + 1, across);
      if (row + 1 < height) compare(i, i + width, down);
    }
  }
  return { depth: kept, left };
}
