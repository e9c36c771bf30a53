// Colours of sparse points.

import { css, signed, table, type Table } from "../model/colours.ts";
import type { Fitted } from "../model/layers.ts";
import { quantiles } from "../model/numbers.ts";
import type { View } from "../model/settings.ts";
import type { Answer } from "../state.ts";

export interface Scale {
  readonly colours: Table;
  readonly low: number;
  readonly high: number;
  readonly label: string;
  readonly value: (point: Fitted) => number | null;
}

/** The colour scale of points; null if they are not coloured by a number (outliers, or none shown). */
export function scale(view: View, answer: Answer | null): Scale | null {
  const value = VALUES[view.marks as keyof typeof VALUES];
  if (!value || !answer) return null;
  const numbers = answer.fitted.flatMap((point) => (point ? [value(point) ?? NaN] : [])).filter(Number.isFinite);
  switch (view.marks) {
    case "residual":
    case "leave-one-out": {
      // Errors far below the accuracy of any map appear as zero.
      const least = 0.005 * answer.middle;
      const most = Math.max(least, quantiles(numbers.map(Math.abs), [0.95])[0] || 0);
      const label = view.marks === "residual" ? "residual" : "leave-one-out error";
      return { colours: signed(), low: -most, high: most, label, value };
    }
    case "deviation":
      return { colours: table("magma"), low: 0, high: quantiles(numbers, [0.95])[0] || 1, label: "standard deviation", value };
    default: {
      const [low, high] = depthRange(view, answer);
      return { colours: table(view.colours), low, high, label: "depth", value };
    }
  }
}

const VALUES = {
  residual: (point: Fitted) => point.residual,
  "leave-one-out": (point: Fitted) => point.leaveOneOut,
  deviation: (point: Fitted) => point.deviation,
  depth: (point: Fitted) => point.depth,
};

export function colour(scale: Scale | null, point: Fitted | null, plain: string): string {
  const value = point && scale ? scale.value(point) : null;
  return value === null || !scale ? plain : css(scale.colours, value, scale.low, scale.high);
}

/** Ends of the colour scale of depth, in metres: quantiles, so a few far pixels do not use up the colours. */
export function depthRange(view: View, answer: Answer): [number, number] {
  return [view.low ?? answer.near, view.high ?? answer.far];
}

export const isOutlier = (point: Fitted | null | undefined): boolean => (point?.outlier ?? 0) > 0.5;
