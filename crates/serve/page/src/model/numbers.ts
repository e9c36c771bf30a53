// Formatting of numbers, quantiles and ticks.

/** Formats a length in metres with about three significant figures. */
export function metres(value: number | null | undefined): string {
  return value === null || value === undefined || !Number.isFinite(value) ? "–" : `${plain(value)} m`;
}

export function plain(value: number): string {
  const size = Math.abs(value);
  const text = size.toFixed(size >= 99.995 ? 1 : size >= 9.9995 ? 2 : size === 0 || size >= 0.09995 ? 3 : 4);
  return value < 0 && Number(text) > 0 ? `−${text}` : text;
}

/** Formats an error with its sign. */
export function withSign(value: number | null): string {
  const text = value === null ? "–" : plain(value);
  return value !== null && value > 0 && Number(text) > 0 ? `+${text}` : text;
}

export const count = (value: number): string => value.toLocaleString("en").replaceAll(",", "\u202f");

export const milliseconds = (seconds: number | undefined): string =>
  seconds === undefined ? "–" : seconds >= 10 ? `${seconds.toFixed(1)} s` : `${Math.round(1000 * seconds)} ms`;

/** Quantiles of the finite values, from a regular sample of at most about 20,000. */
export function quantiles(values: ArrayLike<number>, shares: readonly number[]): number[] {
  const stride = Math.max(1, Math.floor(values.length / 20_000));
  const room = new Float64Array(Math.ceil(values.length / stride));
  let many = 0;
  for (let i = 0; i < values.length; i += stride) if (Number.isFinite(values[i])) room[many++] = values[i]!;
  // Typed arrays sort as numbers, several times faster than with a comparison function.
  const sample = room.subarray(0, many).sort();
  return shares.map((share) => sample[Math.round(share * (sample.length - 1))] ?? NaN);
}

/** Exact median of the positive finite values of a map; of an even number, the upper of the middle two. */
export function median(map: Float32Array): number {
  // The bits of positive floats sort like their values: count the upper halves, then the lower halves within the median's.
  const bits = new Uint32Array(map.buffer, map.byteOffset, map.length);
  const INFINITE = 0x7f800000;
  const counts = (upper: number | null): Uint32Array => {
    const found = new Uint32Array(1 << 16);
    for (let i = 0; i < bits.length; i++) {
      const bit = bits[i]!;
      if (bit === 0 || bit >= INFINITE) continue;
      if (upper === null) found[bit >>> 16]!++;
      else if (bit >>> 16 === upper) found[bit & 0xffff]!++;
    }
    return found;
  };
  const uppers = counts(null);
  const many = uppers.reduce((sum, count) => sum + count, 0);
  if (many === 0) return NaN;
  let rank = Math.floor(many / 2);
  const find = (found: Uint32Array): number => {
    let at = 0;
    while (rank >= found[at]!) rank -= found[at++]!;
    return at;
  };
  const upper = find(uppers);
  const lower = find(counts(upper));
  return new Float32Array(Uint32Array.of((upper << 16) | lower).buffer)[0]!;
}

export function range(values: ArrayLike<number>): [number, number] {
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < values.length; i++) {
    const value = values[i]!;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

export function rootMeanSquare(values: readonly number[]): number | null {
  if (values.length === 0) return null;
  return Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
}

/** About `most` round numbers from `low` to `high`. */
export function ticks(low: number, high: number, most: number): number[] {
  if (!(high > low)) return [low];
  const raw = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= raw * 0.999)!;
  const found: number[] = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(i * step);
  return found;
}

/** Formats a tick with as many decimals as the step between ticks. */
export function tick(value: number, all: readonly number[]): string {
  const step = all.length > 1 ? all[1]! - all[0]! : Math.abs(value) || 1;
  return value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))).replace("-", "−");
}

export interface Label {
  readonly text: string;
  /** Position of the tick, and the left end of the text. */
  readonly at: number;
  readonly left: number;
}

/** Labels of round numbers along a line, as many as fit without touching. */
export function labels(low: number, high: number, width: number, measure: (text: string) => number): Label[] {
  const GAP = 6;
  for (let most = Math.max(1, Math.floor(width / 24)); ; most = Math.floor(most * 0.8)) {
    const values = ticks(low, high, Math.max(1, most));
    const found = values.map((value) => {
      const text = tick(value, values);
      const [at, own] = [((value - low) / (high - low)) * width || 0, measure(text)];
      return { text, at, left: Math.min(width - own, Math.max(0, at - own / 2)) };
    });
    const apart = found.every(({ left }, i) => i === 0 || left >= found[i - 1]!.left + measure(found[i - 1]!.text) + GAP);
    if (apart) return found;
    if (most <= 1) return found.slice(0, 1);
  }
}
