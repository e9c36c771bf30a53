// All that the page shows, as one immutable value, and who is told when it changes.

import type { Fitted, Layers } from "./model/layers.ts";
import type { Source } from "./model/link.ts";
import type { Point } from "./model/points.ts";
import type { Draft, View } from "./model/settings.ts";
import type { Intrinsics } from "./service.ts";

/** An image that the service knows. */
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
  /** The points that came with the image. */
  readonly given: readonly Point[];
  readonly pointsName: string | null;
  /** What was assumed when the file of points was read. */
  readonly remarks: readonly string[];
}

/** A fit. */
export interface Answer {
  readonly draft: Draft;
  readonly layers: Layers;
  /** By index of the draft's points; null for those not used. */
  readonly fitted: readonly (Fitted | null)[];
  /** The latest there is; that of an earlier fit if `stale`. */
  readonly deviation: Float32Array | null;
  readonly stale: boolean;
  readonly low: number;
  readonly high: number;
  /** The depths that 1, 50 and 99 % of pixels are below. */
  readonly near: number;
  readonly middle: number;
  readonly far: number;
  /** The deviation that 98 % of pixels are below, and the middle one. */
  readonly highDeviation: number;
  readonly middleDeviation: number;
  /** Root mean square of the errors at points that were not used. */
  readonly heldOut: number | null;
  /** From request to answer. */
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
  /** Where a new point would be: none of the draft's until its depth is accepted. */
  readonly pending: Pixel | null;
  /** Whether the answer is not yet that to the draft, with all that takes longer. */
  readonly fitting: boolean;
  /** What is being waited for, in words. */
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

  /** Told of changes once a frame. */
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
