// Client of the program behind the page, over HTTP.

import { decoded } from "./model/layers.ts";
import { row, type Point } from "./model/points.ts";
import { FORMATS, ServiceError, type Format, type Intrinsics, type Service } from "./service.ts";

const LAYERS = "application/vnd.lsdc.layers";

export const server: Service = {
  reads: "Images: JPEG, PNG, WebP, TIFF, BMP, PNM. Points: depth maps (npy, npz, png, tiff, exr, pfm, h5), tables (csv, txt), clouds with a camera (ply, pcd, las, laz).",
  cameras: true,
  formats: Object.keys(FORMATS) as Format[],
  start: () => json("v1/start"),
  demos: () => json("v1/demo"),
  gallery: () => json("v1/gallery"),
  file: async (address) => (await answer(address, {})).blob(),

  async post(image, camera) {
    const body = new FormData();
    body.set("image", image, image.name);
    if (camera) body.set("camera", camera, camera.name);
    return (await answer("v1/scenes", { method: "POST", body })).json();
  },

  forget: (id) => void fetch(`v1/scenes/${id}`, { method: "DELETE" }).catch(() => undefined),

  async fit(id, points, fit, layers) {
    const reply = await answer(`v1/scenes/${id}/complete`, request(points, { ...fit, layers }, LAYERS));
    return decoded(await reply.arrayBuffer());
  },

  async download(id, points, options, format) {
    return (await answer(`v1/scenes/${id}/complete`, request(points, options, FORMATS[format].type))).blob();
  },

  async cloud({ file, width, height }, points, options, camera) {
    const body = new FormData();
    body.set("image", file, file.name);
    body.set("points", new Blob([JSON.stringify(points.map(row))], { type: "application/json" }), "points.json");
    body.set("camera", new Blob([toml(camera, [width, height])], { type: "application/toml" }), "camera.toml");
    body.set("options", new Blob([JSON.stringify(options)], { type: "application/json" }));
    return (await answer("v1/complete", { method: "POST", body, headers: { Accept: FORMATS.ply.type } })).blob();
  },
};

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
    // Not an answer of the service: report the status alone.
  }
  return new ServiceError(
    error.message ?? `the program answered with status ${reply.status}`,
    error.hint ?? null,
    reply.status,
    error.request ?? reply.headers.get("X-Request-Id"),
    after > 0 ? after : null,
  );
}
