// NumPy array files: row-major maps of float32 or float64.

export interface Map2 {
  readonly width: number;
  readonly height: number;
  readonly values: Float32Array;
}

/** Reads the map of an `npy` file; null if it is not one, or not two-dimensional. */
export function read(buffer: ArrayBuffer): Map2 | null {
  const bytes = new Uint8Array(buffer);
  const magic = [0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59];
  if (bytes.length < 10 || magic.some((byte, i) => bytes[i] !== byte)) return null;
  const view = new DataView(buffer);
  const start = bytes[6] === 1 ? 10 + view.getUint16(8, true) : 12 + view.getUint32(8, true);
  const header = new TextDecoder().decode(bytes.slice(10, start));
  const shape = /'shape':\s*\((\d+),\s*(\d+),?\s*\)/.exec(header);
  const type = /'descr':\s*'<f([48])'/.exec(header);
  if (!shape || !type || header.includes("'fortran_order': True")) return null;
  const [height, width] = [Number(shape[1]), Number(shape[2])];
  const size = Number(type[1]);
  if (start + size * width * height > buffer.byteLength) return null;
  const body = buffer.slice(start, start + size * width * height);
  return { width, height, values: size === 4 ? new Float32Array(body) : Float32Array.from(new Float64Array(body)) };
}
