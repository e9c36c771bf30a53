// Interface to the service that completes the images of the page.

import type { Layers } from "./model/layers.ts";
import type { Point } from "./model/points.ts";
import type { Fit } from "./model/settings.ts";

/** An error, with a hint at what to do about it. */
export class ServiceError extends Error {
  constructor(
    message: string,
    readonly hint: string | null,
    readonly status: number,
    readonly request: string | null = null,
    readonly retryAfter: number | null = null,
  ) {
    super(message);
  }
}

export interface Intrinsics {
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
}

export interface PostedScene {
  readonly id: string;
  readonly width: number;
  readonly height: number;
  readonly weights?: string;
  readonly camera?: Intrinsics | null;
}

export interface Demo {
  readonly name: string;
  readonly title?: string;
  readonly image: string;
  readonly points: string | number[][];
}

export interface Start {
  readonly image?: string | null;
  readonly name?: string | null;
  readonly points?: string | number[][] | null;
  readonly camera?: string | null;
  readonly gallery?: boolean;
  readonly version?: string;
}

export interface Frame {
  readonly id: string;
  readonly image?: string | null;
  readonly thumbnail?: string | null;
  readonly depth?: string | null;
  readonly deviation?: string | null;
  readonly points?: string | null;
  readonly error?: number | null;
  readonly error_kind?: string;
  readonly standard_deviation?: number | null;
  readonly failure?: string | null;
}

export interface Run {
  readonly name: string;
  readonly frames: readonly Frame[];
}

export type Asked = "depth" | "standard_deviation" | "outliers";

/** Formats of downloads. */
export const FORMATS = {
  png: { type: "image/png", suffix: "_depth.png", label: "PNG", note: "16 bits, millimetres" },
  exr: { type: "image/x-exr", suffix: "_depth.exr", label: "EXR", note: "float32, metres" },
  npz: { type: "application/x-npz", suffix: "_depth.npz", label: "NPZ", note: "depth and standard deviation" },
  ply: { type: "application/x-ply", suffix: "_cloud.ply", label: "PLY", note: "coloured point cloud" },
  json: { type: "application/json", suffix: "_report.json", label: "JSON", note: "report, without pixels" },
} as const;
export type Format = keyof typeof FORMATS;

/** Settings of the fit, and of the pixels that a cloud keeps. */
export type Options = Fit & { readonly max_sigma?: number | null; readonly max_relative_sigma?: number; readonly keep_flying?: boolean };

/** An image posted to the service. */
export interface Posted {
  readonly id: string;
  readonly file: File;
  readonly width: number;
  readonly height: number;
}

/** Completes images for the page: a client of the program, or a worker in the browser. */
export interface Service {
  /** Description of the supported files. */
  readonly reads: string;
  /** Whether camera files are supported. */
  readonly cameras: boolean;
  readonly formats: readonly Format[];
  start(): Promise<Start>;
  demos(): Promise<Demo[]>;
  gallery(): Promise<{ runs: Run[] }>;
  file(address: string): Promise<Blob>;
  post(image: File, camera: File | null): Promise<PostedScene>;
  /** Releases an image before it expires. */
  forget(id: string): void;
  fit(id: string, points: readonly Point[] | File, fit: Fit, layers: readonly Asked[]): Promise<Layers>;
  download(id: string, points: readonly Point[], options: Options, format: Format): Promise<Blob>;
  /** The point cloud of an image that was posted without a camera. */
  cloud(scene: Posted, points: readonly Point[], options: Options, camera: Intrinsics): Promise<Blob>;
}
