// The camera of an image, or one that is assumed.

import type { Intrinsics } from "../service.ts";

interface Size {
  readonly width: number;
  readonly height: number;
}

/** A camera of this horizontal field of view in degrees, which looks through the middle of the image. */
export function assumed({ width, height }: Size, field: number): Intrinsics {
  const focal = width / 2 / Math.tan((field * Math.PI) / 360);
  return { fx: focal, fy: focal, cx: (width - 1) / 2, cy: (height - 1) / 2 };
}
