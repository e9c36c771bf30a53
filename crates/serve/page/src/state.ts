// State of the page as one immutable value, and a store that notifies listeners of changes.

import type { Fitted, Layers } from "./model/layers.ts";
import type { Source } from "./model/link.ts";
import type { Point } from "./model/points.ts";
import type { Draft, View } from "./model/settings.ts";
import type { Intrinsics } from "./service.ts";

/** The open image. */
export interface Scene {
  readonly id: string;
  readonly name: string;
  readonly width: number;
  readonly height: number;
  /** Null if the browser cannot show files of this kind. */
  readonly picture: ImageBitmap | null;
  readonly file: File;
  readonly camera: Intrinsics | null;
  readonly cameraFile: File | null;
  readonly source: Source;
  /** Points that came with the image. */
  readonly given: readonly Point[];
  readonly pointsName: string | null;
  /** Assumptions made when the file of points was read. */
  readonly remarks: readonly string[];
}

/** The result of a fit. */
export interface Answer {
  readonly draft: Draft;
  readonly layers: Layers;
  /** Results at the points of the draft, by index; null for points not used. */
  readonly fitted: readonly (Fitted | null)[];
  /** Latest standard deviations; from an earlier fit if `stale`. */
  readonly deviation: Float32Array | null;
  readonly stale: boolean;
  readonly low: number;
  readonly high: number;
  /** Quantiles of the depths: 1, 50 and 99 %. */
  readonly near: number;
  readonly middle: number;
  readonly far: number;
  /** 98 % quantile and median of the standard deviations. */
  readonly highDeviation: number;
  readonly middleDeviation: number;
  /** Root mean square of the errors at points that were not used. */
  readonly heldOut: number | null;
  /** Time from request to answer. */
  readonly seconds: number;
}

export interface Pixel {
  readonly u: number;
  readonly v: number;
}

export interface Notice {
  readonly kind: "error" | "note";
  readonly message: string;
  readonly hint: string | null;
  readonly action?: { readonly label: string; readonly run: () => void };
}

export interface State {
  readonly scene: Scene | null;
  readonly draft: Draft;
  readonly used: readonly boolean[];
  readonly answer: Answer | null;
  readonly view: View;
  readonly selected: number | null;
  readonly cursor: Pixel | null;
  /** Position of a new point, which joins the draft once its depth is accepted. */
  readonly pending: Pixel | null;
  /** Whether results of the current draft, slow ones included, are still missing. */
  readonly fitting: boolean;
  /** Description of the operation in progress. */
  readonly waiting: string | null;
  readonly notice: Notice | null;
  readonly canUndo: boolean;
  readonly canRedo: boolean;
}

export class Store {
  private readonly listeners: ((state: State) => void)[] = [];
  private scheduled = false;

  constructor(private value: State) {}

  get state(): State {
    return this.value;
  }

  /** Calls the listener at most once per animation frame, after changes. */
  watch(listener: (state: State) => void): void {
    this.listeners.push(listener);
    this.schedule();
  }

  set(change: Partial<State>): void {
    this.value = { ...this.value, ...change };
    this.schedule();
  }

  private schedule(): void {
    if (this.scheduled) return;
    this.scheduled = true;
    requestAnimationFrame(() => {
      this.scheduled = false;
      for (const listener of this.listeners) listener(this.value);
    });
  }
}
