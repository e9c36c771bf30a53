// Numbers as people read them, and what is typical of many.

/** A length with its unit: three figures, as few decimals as they need. */
export function metres(value: number | null | undefined): string {
  return value === null || value === undefined || !Number.isFinite(value) ? "–" : `${plain(value)} m`;
}

export function plain(value: number): string {
  const size = Math.abs(value);
  const text = size.toFixed(size >= 99.995 ? 1 : size >= 9.9995 ? 2 : size === 0 || size >= 0.09995 ? 3 : 4);
  return value < 0 && Number(text) > 0 ? `−${text}` : text;
}

/** With its sign, for errors. */
export function withSign(value: number | null): string {
  const text = value === null ? "–" : plain(value);
  return value !== null && value > 0 && Number(text) > 0 ? `+${text}` : text;
}

export const count = (value: number): string => value.toLocaleString("en").replaceAll(",", "\u202f");

export const milliseconds = (seconds: number | undefined): string =>
  seconds === undefined ? "–" : seconds >= 10 ? `${seconds.toFixed(1)} s` : `${Math.round(1000 * seconds)} ms`;

/** The values at shares of the sorted finite ones. */
export function quantiles(values: ArrayLike<number>, shares: readonly number[]): number[] {
  if (values instanceof Float32Array && values.length > MANY) return selected(values, shares);
  // Typed arrays are sorted as numbers, several times faster than by a comparison.
  const sorted = Float64Array.from(values).filter(Number.isFinite).sort();
  return shares.map((share) => sorted[Math.round(share * (sorted.length - 1))] ?? NaN);
}

/** Fewer values than these are sorted. */
const MANY = 4096;
const HALF = 1 << 16;

/** The same for many values, without sorting: counts by the upper halves of their bits, then by the lower ones. */
function selected(values: Float32Array, shares: readonly number[]): number[] {
  const bits = new Uint32Array(values.buffer, values.byteOffset, values.length);
  // As unsigned numbers, these are in the order of the values.
  const key = (bit: number) => (bit & 0x80000000 ? ~bit : bit | 0x80000000) >>> 0;
  const finite = (bit: number) => (bit & 0x7f800000) !== 0x7f800000;
  const upper = new Uint32Array(HALF);
  let many = 0;
  for (const bit of bits) {
    if (!finite(bit)) continue;
    upper[key(bit) >>> 16]!++;
    many++;
  }
  return shares.map((share) => {
    if (many === 0) return NaN;
    let rank = Math.round(share * (many - 1));
    const find = (counts: Uint32Array) => {
      let at = 0;
      while (rank >= counts[at]!) rank -= counts[at++]!;
      return at;
    };
    const high = find(upper);
    const lower = new Uint32Array(HALF);
    for (const bit of bits) if (finite(bit) && key(bit) >>> 16 === high) lower[key(bit) & (HALF - 1)]!++;
    const found = ((high << 16) | find(lower)) >>> 0;
    const bit = found & 0x80000000 ? found & 0x7fffffff : ~found;
    return new Float32Array(Uint32Array.of(bit >>> 0).buffer)[0]!;
  });
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

/** A round number of the step between ticks has as many decimals as the step. */
export function tick(value: number, all: readonly number[]): string {
  const step = all.length > 1 ? all[1]! - all[0]! : Math.abs(value) || 1;
  return value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))).replace("-", "−");
}

export interface Label {
  readonly text: string;
  /** Where its tick is, and where the text begins. */
  readonly at: number;
  readonly left: number;
}

/** Labels of as many round numbers along a line as do not touch each other. */
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
