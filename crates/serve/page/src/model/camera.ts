// The camera assumed for images without one.

import type { Intrinsics } from "../service.ts";

interface Size {
  readonly width: number;
  readonly height: number;
}

/** A camera with a horizontal field of view in degrees and its principal point at the image centre. */
export function assumed({ width, height }: Size, field: number): Intrinsics {
  const focal = width / 2 / Math.tan((field * Math.PI) / 360);
  return { fx: focal, fy: focal, cx: (width - 1) / 2, cy: (height - 1) / 2 };
}
