// All settings as the fragment of a URL. Defaults are left out; settings that cannot be read are ignored.

import { MAPS } from "./colours.ts";
import { packed, unpacked, type Point } from "./points.ts";
import {
  CLOUDS, FIT, FITS, LAYERS, MARKS, PRIORS, ROBUST, THEMES, VIEW,
  type Fit, type Orbit, type View,
} from "./settings.ts";

/** Image of a link: a demo by name, or a file that the reader has to open. */
export type Source = { readonly demo: string } | { readonly file: string; readonly width: number; readonly height: number };

export interface Linked {
  readonly source: Source | null;
  readonly fit: Fit;
  readonly count: number | null;
  readonly view: View;
  /** Null: the points that come with the image. */
  readonly points: readonly Point[] | null;
  /** Number of points left out because a link holds at most `MOST_POINTS`. */
  readonly omitted: number;
}

/** About 70 kB of text. */
export const MOST_POINTS = 4000;

type Form<T> = { write(value: T): string; read(text: string): T | undefined };

const one = <T extends string>(names: readonly T[]): Form<T> => ({
  write: (name) => name,
  read: (text) => names.find((name) => name === text),
});
const number = (digits: number, low = -Infinity, high = Infinity): Form<number> => ({
  write: (value) => String(Number(value.toPrecision(digits))),
  read: (text) => {
    const value = text === "" ? NaN : Number(text);
    return value >= low && value <= high ? value : undefined;
  },
});
const yesOrNo: Form<boolean> = {
  write: (value) => (value ? "yes" : "no"),
  read: (text) => (text === "yes" ? true : text === "no" ? false : undefined),
};
const orNull = <T>(form: Form<T>): Form<T | null> => ({
  write: (value) => (value === null ? "" : form.write(value)),
  read: (text) => (text === "" ? null : form.read(text)),
});
const orbit: Form<Orbit> = {
  write: ({ yaw, pitch, distance, x, y, z }) => [yaw, pitch, distance, x, y, z].map((a) => Number(a.toFixed(3))).join(","),
  read: (text) => {
    const numbers = text.split(",").map(Number);
    if (numbers.length !== 6 || !numbers.every(Number.isFinite) || !(numbers[2]! > 0)) return undefined;
    const [yaw, pitch, distance, x, y, z] = numbers as [number, number, number, number, number, number];
    return { yaw, pitch, distance, x, y, z };
  },
};

const FIT_FORMS: { [Key in keyof Fit]: Form<Fit[Key]> } = {
  robust: orNull(one(ROBUST)),
  fit: orNull(one(FITS)),
  prior: orNull(one(PRIORS)),
  sigma: orNull(number(6, 0)),
};
const VIEW_FORMS: { [Key in keyof View]: Form<View[Key]> } = {
  layer: one(LAYERS),
  opacity: number(3, 0, 1),
  marks: one(MARKS),
  marksOpacity: number(3, 0, 1),
  colours: one(MAPS),
  low: orNull(number(6, 0)),
  high: orNull(number(6, 0)),
  cloud: one(CLOUDS),
  cut: orNull(number(6, 0)),
  flying: yesOrNo,
  unmeasured: yesOrNo,
  field: number(6, 5, 170),
  orbit,
  theme: one(THEMES),
};
const COUNT = orNull(number(9, 1));

export function written(linked: Omit<Linked, "omitted">): string {
  const fields = new URLSearchParams();
  const { source } = linked;
  if (source && "demo" in source) fields.set("demo", source.demo);
  else if (source) {
    fields.set("image", source.file);
    fields.set("size", `${source.width}x${source.height}`);
  }
  put(fields, FIT_FORMS, linked.fit, FIT);
  if (linked.count !== null) fields.set("count", COUNT.write(linked.count));
  put(fields, VIEW_FORMS, linked.view, VIEW);
  if (linked.points && linked.points.length <= MOST_POINTS) fields.set("points", packed(linked.points));
  else if (linked.points) fields.set("omitted", String(linked.points.length));
  return fields.toString();
}

export function read(fragment: string): Linked {
  const fields = new URLSearchParams(fragment.replace(/^#/, ""));
  const points = fields.get("points");
  return {
    source: source(fields),
    fit: taken(fields, FIT_FORMS, FIT),
    count: COUNT.read(fields.get("count") ?? "") ?? null,
    view: taken(fields, VIEW_FORMS, VIEW),
    points: points === null ? null : unpacked(points),
    omitted: Number(fields.get("omitted")) || 0,
  };
}

function source(fields: URLSearchParams): Source | null {
  const demo = fields.get("demo");
  if (demo) return { demo };
  const file = fields.get("image");
  const size = /^(\d+)x(\d+)$/.exec(fields.get("size") ?? "");
  return file && size ? { file, width: Number(size[1]), height: Number(size[2]) } : null;
}

function put<T extends object>(fields: URLSearchParams, forms: { [K in keyof T]: Form<T[K]> }, value: T, plain: T): void {
  for (const key of Object.keys(forms) as (keyof T & string)[]) {
    const text = forms[key].write(value[key]);
    if (text !== forms[key].write(plain[key])) fields.set(key, text);
  }
}

function taken<T extends object>(fields: URLSearchParams, forms: { [K in keyof T]: Form<T[K]> }, plain: T): T {
  const value = { ...plain };
  for (const key of Object.keys(forms) as (keyof T & string)[]) {
    const text = fields.get(key);
    const found = text === null ? undefined : forms[key].read(text);
    if (found !== undefined) value[key] = found;
  }
  return value;
}
