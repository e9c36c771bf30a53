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

/** Values at shares of the sorted finite ones, from at most about 20,000 of them. */
export function quantiles(values: ArrayLike<number>, shares: readonly number[]): number[] {
  const stride = Math.max(1, Math.floor(values.length / 20_000));
  const room = new Float64Array(Math.ceil(values.length / stride));
  let many = 0;
  for (let i = 0; i < values.length; i += stride) if (Number.isFinite(values[i])) room[many++] = values[i]!;
  // Typed arrays are sorted as numbers, several times faster than by a comparison.
  const sample = room.subarray(0, many).sort();
  return shares.map((share) => sample[Math.round(share * (sample.length - 1))] ?? NaN);
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
