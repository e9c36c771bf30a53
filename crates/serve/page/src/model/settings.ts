// What the page can be set to: what is fitted, and how it is shown.

import { MAPS, type MapName } from "./colours.ts";
import type { Point } from "./points.ts";

export const ROBUST = ["none", "auto", "huber", "cauchy", "gm", "tukey", "irls"] as const;
export const FITS = ["joint", "lse", "field"] as const;
export const PRIORS = ["learned", "flat", "none"] as const;
export const LAYERS = ["depth", "deviation", "none"] as const;
export const MARKS = ["residual", "leave-one-out", "deviation", "outlier", "depth", "none"] as const;
export const CLOUDS = ["image", "depth", "deviation"] as const;
export const THEMES = ["auto", "light", "dark"] as const;

/** Settings of the fit; null: as stored with the weights. */
export interface Fit {
  readonly robust: (typeof ROBUST)[number] | null;
  readonly fit: (typeof FITS)[number] | null;
  readonly prior: (typeof PRIORS)[number] | null;
  /** Standard deviation in metres of points without their own. */
  readonly sigma: number | null;
}

/** What can be undone. */
export interface Draft {
  readonly points: readonly Point[];
  readonly fit: Fit;
  /** How many of the points are used; null: all. */
  readonly count: number | null;
}

/** Angles in radians; lengths in median depths of the scene. */
export interface Orbit {
  readonly yaw: number;
  readonly pitch: number;
  readonly distance: number;
  readonly x: number;
  readonly y: number;
  readonly z: number;
}

export interface View {
  readonly layer: (typeof LAYERS)[number];
  readonly opacity: number;
  readonly marks: (typeof MARKS)[number];
  readonly marksOpacity: number;
  readonly colours: MapName;
  /** Ends of the colours of depth in metres; null: those of 98 % of the map. */
  readonly low: number | null;
  readonly high: number | null;
  readonly cloud: (typeof CLOUDS)[number];
  /** The largest standard deviation of points in the cloud, in metres; null: none is left out. */
  readonly cut: number | null;
  /** Whether the cloud keeps flying pixels. */
  readonly flying: boolean;
  /** Whether it keeps pixels that count as not measured. */
  readonly unmeasured: boolean;
  /** Horizontal field of view in degrees, for images without a camera. */
  readonly field: number;
  readonly orbit: Orbit;
  readonly theme: (typeof THEMES)[number];
}

export const FIT: Fit = { robust: null, fit: null, prior: null, sigma: null };
export const DRAFT: Draft = { points: [], fit: FIT, count: null };
export const ORBIT: Orbit = { yaw: 0.3, pitch: 0.24, distance: 1.36, x: 0.09, y: -0.05, z: 0 };
export const VIEW: View = {
  layer: "depth",
  opacity: 0.85,
  marks: "leave-one-out",
  marksOpacity: 1,
  colours: "viridis",
  low: null,
  high: null,
  cloud: "image",
  cut: null,
  flying: false,
  unmeasured: false,
  field: 60,
  orbit: ORBIT,
  theme: "auto",
};

/** A pixel whose standard deviation is a larger share of its depth counts as not measured, as for `lsdc complete`. */
export const MEASURED = 0.1;
/** A share that no standard deviation exceeds. */
export const NO_LIMIT = 1e6;

/** The view of another image: what depends on its depths or its camera is as at the start. */
export const renewed = (view: View): View =>
  ({ ...view, low: VIEW.low, high: VIEW.high, cut: VIEW.cut, flying: VIEW.flying, unmeasured: VIEW.unmeasured, field: VIEW.field, orbit: VIEW.orbit });

export const isMap = (name: string): name is MapName => (MAPS as readonly string[]).includes(name);
