// Conversion of images to the module's format: rows of pixels with 8 bits per channel.

import { LsdcError } from "./error.ts";

/** Pixels row by row, without gaps: grey, RGB or RGBA of 8 bits each, according to their number, such as `ImageData`. */
export interface Pixels {
  readonly width: number;
  readonly height: number;
  readonly data: Uint8Array | Uint8ClampedArray;
}

export type ImageSource = Pixels | ImageData | ImageBitmap | HTMLCanvasElement | OffscreenCanvas;

/** Returns the pixels of an image. */
export function pixels(source: ImageSource): Pixels & { readonly channels: number } {
  const { width, height, data } = "data" in source ? source : drawn(source);
  if (!(data instanceof Uint8Array || data instanceof Uint8ClampedArray)) {
    throw new LsdcError("image", "the pixels of the image are not bytes", "give a Uint8Array or a Uint8ClampedArray");
  }
  if (!(Number.isInteger(width) && Number.isInteger(height) && width > 0 && height > 0)) {
    throw new LsdcError("image", `an image cannot have ${width}x${height} pixels`);
  }
  const channels = data.length / (width * height);
  if (channels !== 1 && channels !== 3 && channels !== 4) {
    const hint = "pixels have 1, 3 or 4 bytes (grey, RGB or RGBA), without gaps between rows";
    throw new LsdcError("image", `${data.length} bytes are not those of ${width}x${height} pixels`, hint);
  }
  return { width, height, data, channels };
}

function drawn(source: ImageBitmap | HTMLCanvasElement | OffscreenCanvas): ImageData {
  const { width, height } = source;
  if (!(width > 0 && height > 0)) throw new LsdcError("image", `an image cannot have ${width}x${height} pixels`);
  const canvas = "getContext" in source ? source : new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d", { willReadFrequently: true }) as CanvasRenderingContext2D | OffscreenCanvasRenderingContext2D | null;
  if (!context) throw new LsdcError("image", "the canvas has no 2D context", "draw it onto one that has");
  if (canvas !== source) context.drawImage(source, 0, 0);
  return context.getImageData(0, 0, width, height);
}
