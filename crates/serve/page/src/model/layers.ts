// Decodes `application/vnd.lsdc.layers`: the length of a header, the header in JSON, then float32 maps.

export interface Fitted {
  readonly index: number;
  readonly u: number;
  readonly v: number;
  readonly depth: number;
  readonly sigma: number | null;
  /** Measurement minus map, in metres: positive if the point is farther away. */
  readonly residual: number | null;
  /** Leave-one-out error: measurement minus the map fitted without this point, in metres. */
  readonly leaveOneOut: number | null;
  /** Standard deviation of the map at the point, in metres. */
  readonly deviation: number | null;
  /** Outlier probability if above one half, otherwise 0; null if not requested. */
  readonly outlier: number | null;
}

export interface Report {
  readonly depth?: { lowest?: number; highest?: number };
  readonly fit?: {
    method?: string;
    residual?: number | null;
    leave_one_out?: number | null;
    outliers?: number | null;
    deviations_of_95?: number | null;
  };
  readonly points?: Record<string, unknown>;
  readonly seconds?: Record<string, number>;
  /** Assumptions and omissions that the user should check. */
  readonly remarks?: readonly string[];
}

export interface Layers {
  readonly width: number;
  readonly height: number;
  readonly depth: Float32Array;
  /** Null if not requested. */
  readonly deviation: Float32Array | null;
  readonly points: readonly Fitted[];
  readonly report: Report;
}

export class LayersError extends Error {}

export function decoded(buffer: ArrayBuffer): Layers {
  if (buffer.byteLength < 4) throw new LayersError("an answer of less than four bytes");
  const start = 4 + new DataView(buffer).getUint32(0, true);
  if (start % 4 !== 0 || start > buffer.byteLength) throw new LayersError("an answer whose header does not fit");
  let header: Record<string, unknown>;
  try {
    header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, start - 4)));
  } catch {
    throw new LayersError("an answer whose header is no JSON");
  }
  const { width, height } = header;
  if (typeof width !== "number" || typeof height !== "number") throw new LayersError("a header without a size");
  const places = list(header.layers);
  const map = (name: string) => {
    const place = places.find((layer) => layer.name === name);
    if (!place) return null;
    const { offset, length } = place;
    const fits = typeof offset === "number" && offset % 4 === 0 && start + offset + 4 * width * height <= buffer.byteLength;
    if (!fits || length !== 4 * width * height) throw new LayersError(`the layer \`${name}\` has another size`);
    return new Float32Array(buffer, start + offset, width * height);
  };
  const depth = map("depth");
  if (!depth) throw new LayersError("an answer without depth");
  const points = list(header.points).map(fitted);
  return { width, height, depth, deviation: map("standard_deviation"), points, report: (header.report ?? {}) as Report };
}

function fitted(point: Record<string, unknown>, place: number): Fitted {
  const number = (key: string) => (typeof point[key] === "number" ? (point[key] as number) : null);
  return {
    index: number("index") ?? place,
    u: number("u") ?? 0,
    v: number("v") ?? 0,
    depth: number("depth") ?? 0,
    sigma: number("sigma"),
    residual: number("residual"),
    leaveOneOut: number("leave_one_out"),
    deviation: number("standard_deviation"),
    outlier: point.outlier === true ? 1 : point.outlier === false ? 0 : number("outlier"),
  };
}

const list = (value: unknown): Record<string, unknown>[] => (Array.isArray(value) ? value : []);
