// The service behind the page.

import { decoded, type Layers } from "./model/layers.ts";
import { row, type Point } from "./model/points.ts";
import type { Fit } from "./model/settings.ts";

/** What went wrong, and what to do about it. */
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

/** What can be downloaded. */
export const FORMATS = {
  png: { type: "image/png", suffix: "_depth.png", label: "PNG", note: "16 bits, millimetres" },
  exr: { type: "image/x-exr", suffix: "_depth.exr", label: "EXR", note: "float32, metres" },
  npz: { type: "application/x-npz", suffix: "_depth.npz", label: "NPZ", note: "depth and standard deviation" },
  ply: { type: "application/x-ply", suffix: "_cloud.ply", label: "PLY", note: "coloured point cloud" },
  json: { type: "application/json", suffix: "_report.json", label: "JSON", note: "report, without pixels" },
} as const;
export type Format = keyof typeof FORMATS;

const LAYERS = "application/vnd.lsdc.layers";

export const start = (): Promise<Start> => json("v1/start");
export const demos = (): Promise<Demo[]> => json("v1/demo");
export const gallery = (): Promise<{ runs: Run[] }> => json("v1/gallery");
export const file = async (address: string): Promise<Blob> => (await answer(address, {})).blob();

export async function post(image: File, camera: File | null): Promise<PostedScene> {
  const body = new FormData();
  body.set("image", image, image.name);
  if (camera) body.set("camera", camera, camera.name);
  return (await answer("v1/scenes", { method: "POST", body })).json();
}

/** Frees what the service keeps of an image. It would expire anyway. */
export const forget = (id: string): void => void fetch(`v1/scenes/${id}`, { method: "DELETE" }).catch(() => undefined);

export async function fit(id: string, points: readonly Point[] | File, fit: Fit, layers: readonly Asked[]): Promise<Layers> {
  const reply = await answer(`v1/scenes/${id}/complete`, request(points, { ...fit, layers }, LAYERS));
  return decoded(await reply.arrayBuffer());
}

/** A fit, and which pixels a cloud has. */
type Options = Fit & { readonly max_sigma?: number | null; readonly keep_flying?: boolean };

export async function download(id: string, points: readonly Point[], options: Options, format: Format): Promise<Blob> {
  return (await answer(`v1/scenes/${id}/complete`, request(points, options, FORMATS[format].type))).blob();
}

/** A point cloud of an image that was posted without its camera. */
export async function cloud(image: File, points: readonly Point[], options: Options, camera: Intrinsics, size: [number, number]): Promise<Blob> {
  const body = new FormData();
  body.set("image", image, image.name);
  body.set("points", new Blob([JSON.stringify(points.map(row))], { type: "application/json" }), "points.json");
  body.set("camera", new Blob([toml(camera, size)], { type: "application/toml" }), "camera.toml");
  body.set("options", new Blob([JSON.stringify(options)], { type: "application/json" }));
  return (await answer("v1/complete", { method: "POST", body, headers: { Accept: FORMATS.ply.type } })).blob();
}

const toml = ({ fx, fy, cx, cy }: Intrinsics, [width, height]: [number, number]): string =>
  Object.entries({ width, height, fx, fy, cx, cy }).map(([key, value]) => `${key} = ${value}\n`).join("");

function request(points: readonly Point[] | File, options: object, accept: string): RequestInit {
  const headers = { Accept: accept };
  if (!(points instanceof File)) {
    const body = JSON.stringify({ points: points.map(row), options });
    return { method: "POST", headers: { ...headers, "Content-Type": "application/json" }, body };
  }
  const body = new FormData();
  body.set("points", points, points.name);
  body.set("options", new Blob([JSON.stringify(options)], { type: "application/json" }));
  return { method: "POST", headers, body };
}

const json = async <T>(address: string): Promise<T> => (await answer(address, { headers: { Accept: "application/json" } })).json();

async function answer(address: string, init: RequestInit): Promise<Response> {
  let reply: Response;
  try {
    reply = await fetch(address, init);
  } catch {
    throw new ServiceError("the program does not answer", "check that `lsdc view` is still running, then try again", 0);
  }
  if (reply.ok) return reply;
  throw refusal(reply, await reply.text());
}

function refusal(reply: Response, text: string): ServiceError {
  const after = Number(reply.headers.get("Retry-After"));
  let error: { message?: string; hint?: string | null; request?: string } = {};
  try {
    error = JSON.parse(text).error ?? {};
  } catch {
    // Not from the service itself; the status has to do.
  }
  return new ServiceError(
    error.message ?? `the program answered with status ${reply.status}`,
    error.hint ?? null,
    reply.status,
    error.request ?? reply.headers.get("X-Request-Id"),
    after > 0 ? after : null,
  );
}
