// Sparse points: subsets, text forms, and values of a map at positions.

/** A known depth: column and row in pixels from the centre of the first pixel, metres along the optical axis. */
export interface Point {
  readonly u: number;
  readonly v: number;
  readonly depth: number;
  /** Standard deviation in metres, if it is known. */
  readonly sigma?: number;
  /** Whether the point was placed on the page; a subset takes such points first. */
  readonly placed?: boolean;
}

export type Row = [number, number, number] | [number, number, number, number];

export const row = ({ u, v, depth, sigma }: Point): Row => (sigma === undefined ? [u, v, depth] : [u, v, depth, sigma]);

/**
 * Selects `count` pseudorandom points. Subsets are nested and keep their members when points are added at the end; points
 * placed on the page come first.
 */
export function subset(points: readonly Point[], count: number | null): boolean[] {
  if (count === null || count >= points.length) return points.map(() => true);
  const keys = points.map((point, i) => (point.placed ? -1 : scattered(i)));
  const order = points.map((_, i) => i).sort((a, b) => keys[a]! - keys[b]! || a - b);
  const used = points.map(() => false);
  for (const i of order.slice(0, Math.max(1, count))) used[i] = true;
  return used;
}

/** Hashes an index to a pseudorandom number (after the finaliser of MurmurHash3). */
function scattered(index: number): number {
  let h = index + 1;
  h = Math.imul(h ^ (h >>> 16), 0x85ebca6b);
  h = Math.imul(h ^ (h >>> 13), 0xc2b2ae35);
  return (h ^ (h >>> 16)) >>> 0;
}

/** Points as a table that `lsdc complete` reads. */
export function csv(points: readonly Point[]): string {
  const sigmas = points.some((point) => point.sigma !== undefined);
  const lines = points.map(({ u, v, depth, sigma }) => [u, v, depth, ...(sigmas ? [sigma ?? ""] : [])].join(","));
  return [sigmas ? "u,v,depth,sigma" : "u,v,depth", ...lines, ""].join("\n");
}

/** Encodes each point as a byte of flags and float32s, in URL-safe base64. */
export function packed(points: readonly Point[]): string {
  const bytes: number[] = [];
  const float = new DataView(new ArrayBuffer(4));
  for (const point of points) {
    bytes.push((point.sigma === undefined ? 0 : 1) | (point.placed ? 2 : 0));
    for (const value of row(point)) {
      float.setFloat32(0, value, true);
      for (let i = 0; i < 4; i++) bytes.push(float.getUint8(i));
    }
  }
  let text = "";
  for (const byte of bytes) text += String.fromCharCode(byte);
  return btoa(text).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

/** Decodes the text of `packed`; null if it is malformed. */
export function unpacked(text: string): Point[] | null {
  let binary: string;
  try {
    binary = atob(text.replaceAll("-", "+").replaceAll("_", "/"));
  } catch {
    return null;
  }
  const view = new DataView(Uint8Array.from(binary, (letter) => letter.charCodeAt(0)).buffer);
  const points: Point[] = [];
  for (let at = 0; at < view.byteLength; ) {
    const has = view.getUint8(at++);
    const values = has & 1 ? 4 : 3;
    if (has > 3 || at + 4 * values > view.byteLength) return null;
    const [u, v, depth, sigma] = Array.from({ length: values }, (_, i) => view.getFloat32(at + 4 * i, true));
    at += 4 * values;
    if (![u, v, depth].every(Number.isFinite) || !(depth! > 0)) return null;
    points.push({ u: u!, v: v!, depth: depth!, ...(sigma !== undefined && { sigma }), ...(has & 2 && { placed: true }) });
  }
  return points;
}

/** Bilinear interpolation of a map, clamped at its border. */
export function sampled(map: Float32Array, width: number, height: number, u: number, v: number): number {
  const x = Math.min(width - 1, Math.max(0, u));
  const y = Math.min(height - 1, Math.max(0, v));
  const left = Math.min(Math.floor(x), Math.max(0, width - 2));
  const top = Math.min(Math.floor(y), Math.max(0, height - 2));
  const right = Math.min(left + 1, width - 1);
  const bottom = Math.min(top + 1, height - 1);
  const at = (column: number, line: number) => map[line * width + column]!;
  const mix = (a: number, b: number, share: number) => a + (b - a) * share;
  return mix(
    mix(at(left, top), at(right, top), x - left),
    mix(at(left, bottom), at(right, bottom), x - left),
    y - top,
  );
}
