// Colour maps as tables of 256 colours. Viridis and magma are perceptually uniform. Turbo, the map of `lsdc complete`, shows
// more steps, but its lightness is not monotonic.

export const MAPS = ["viridis", "magma", "turbo", "grey"] as const;
export type MapName = (typeof MAPS)[number];

/** 256 colours, four bytes each: red, green, blue, 255. */
export type Table = Uint8ClampedArray;

// 33 equally spaced colours of Matplotlib's maps; linear interpolation between them is off by at most 2 of 255.
const STOPS: Record<MapName, string> = {
  viridis:
    "440154470d6048186a482374472d7b4536814240863f49893b528b375a8d33638d2f6a8e2c728e297a8e26818e23898e21908c1f988b1f9f88" +
    "21a68528ae8031b57b3ebc744cc26c5dc9636ece5882d34c96d83fabdc32c0df24d5e21aeae51afde725",
  magma:
    "0000040303110a0822130d331d114628115a36106a430f7650127c5d177f691c817621818226818f2a819c2e7fa9327db63779c33b75cf4170" +
    "db486ae65163ee5c5ef5695cf9785dfb8761fd9668fea571feb47bfec387fed194fde0a2fceeb0fcfdbf",
  turbo:
    "30123b392a734040a14456c7466be3467ff64293ff37a7fa29bbec1dcdd818dcc31ee8b031f2994cf97e6bfd648aff4da3fd3cb8f735cced34" +
    "dee037edd03af8c03afdae35fe982cfb8022f56817ec520fe04009d23105c02302ac1701950d017a0403",
  grey: "0a0a0afafafa",
};

// Diverging map: blue below zero, light grey at zero, red above. Both sides have equal lightness and remain distinguishable
// with red-green colour blindness.
const SIGNED = "0b4f8a3f83bd86b4d8c4d9e6f0efedf2cfbfe59f87c9634c96262b";

const made = new Map<string, Table>();

export const table = (name: MapName): Table => cached(STOPS[name]);
export const signed = (): Table => cached(SIGNED);

function cached(stops: string): Table {
  let colours = made.get(stops);
  if (!colours) made.set(stops, (colours = interpolated(stops)));
  return colours;
}

function interpolated(stops: string): Table {
  const last = stops.length / 6 - 1;
  const channel = (stop: number, which: number) => parseInt(stops.slice(6 * stop + 2 * which, 6 * stop + 2 * which + 2), 16);
  const colours = new Uint8ClampedArray(4 * 256);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * last;
    const stop = Math.min(Math.floor(at), last - 1);
    for (let which = 0; which < 3; which++) {
      const low = channel(stop, which);
      colours[4 * i + which] = Math.round(low + (at - stop) * (channel(stop + 1, which) - low));
    }
    colours[4 * i + 3] = 255;
  }
  return colours;
}

/** Table entry of a value between `low` and `high`; values outside take the colour of the nearer end. */
export function index(value: number, low: number, high: number): number {
  const share = high > low ? (value - low) / (high - low) : 0.5;
  return Math.round(255 * Math.min(1, Math.max(0, share)));
}

export function css(colours: Table, value: number, low: number, high: number): string {
  const i = 4 * index(value, low, high);
  return `rgb(${colours[i]} ${colours[i + 1]} ${colours[i + 2]})`;
}

/** Colours values row by row; NaN becomes transparent. */
export function paint(values: Float32Array, colours: Table, low: number, high: number, pixels: Uint8ClampedArray): void {
  const words = new Uint32Array(pixels.buffer, pixels.byteOffset, values.length);
  const palette = new Uint32Array(colours.buffer);
  const factor = high > low ? 255 / (high - low) : 0;
  for (let i = 0; i < values.length; i++) {
    const at = (values[i]! - low) * factor;
    // Comparisons with NaN are false.
    words[i] = at >= 0 ? palette[at < 255 ? (at + 0.5) | 0 : 255]! : at < 0 ? palette[0]! : 0;
  }
}
