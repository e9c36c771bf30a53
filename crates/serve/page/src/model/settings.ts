// Settings of the fit and of the view.

import { MAPS, type MapName } from "./colours.ts";
import type { Point } from "./points.ts";

export const ROBUST = ["none", "auto", "huber", "cauchy", "gm", "tukey", "irls"] as const;
export const FITS = ["joint", "lse", "field"] as const;
export const PRIORS = ["learned", "flat", "none"] as const;
export const LAYERS = ["depth", "deviation", "none"] as const;
export const MARKS = ["residual", "leave-one-out", "deviation", "outlier", "depth", "none"] as const;
export const CLOUDS = ["image", "depth", "deviation"] as const;
export const THEMES = ["auto", "light", "dark"] as const;

/** Settings of the fit. Null: as stored with the weights. */
export interface Fit {
  readonly robust: (typeof ROBUST)[number] | null;
  readonly fit: (typeof FITS)[number] | null;
  readonly prior: (typeof PRIORS)[number] | null;
  /** Standard deviation, in metres, of points that have none. */
  readonly sigma: number | null;
}

/** State that undo restores. */
export interface Draft {
  readonly points: readonly Point[];
  readonly fit: Fit;
  /** Number of points used. Null: all. */
  readonly count: number | null;
}

/** Viewpoint of the cloud. Angles in radians, lengths in multiples of the median depth. */
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
  /** Ends of the colour scale of depth, in metres. Null: the 1 % and 99 % quantiles of the map. */
  readonly low: number | null;
  readonly high: number | null;
  readonly cloud: (typeof CLOUDS)[number];
  /** Largest standard deviation of pixels in the cloud, in metres. Null: no limit. */
  readonly cut: number | null;
  /** Whether the cloud keeps flying pixels. */
  readonly flying: boolean;
  /** Whether the cloud keeps pixels that count as not measured. */
  readonly unmeasured: boolean;
  /** Horizontal field of view, in degrees, assumed for images without a camera. */
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

/** Relative standard deviation above which a pixel counts as not measured, as for `lsdc complete`. */
export const MEASURED = 0.1;
/** Relative standard deviation that no pixel exceeds. */
export const NO_LIMIT = 1e6;

/** Resets the settings that depend on the depths or the camera of an image. */
export const renewed = (view: View): View =>
  ({ ...view, low: VIEW.low, high: VIEW.high, cut: VIEW.cut, flying: VIEW.flying, unmeasured: VIEW.unmeasured, field: VIEW.field, orbit: VIEW.orbit });

export const isMap = (name: string): name is MapName => (MAPS as readonly string[]).includes(name);
