// Files to download, written in the browser as the program writes them.

import type { Layers } from "../model/layers.ts";
import { flyingPixels } from "../model/flying.ts";
import { range } from "../model/numbers.ts";
import type { Intrinsics } from "../service.ts";
import * as png from "./png.ts";
import { refused } from "./read.ts";

const MOST = 65_535;
/** Units per metre, finest first. */
const UNITS = [1e6, 1e5, 1e4, 1e3, 256, 100, 10, 1];

/** Depths as 16-bit PNG in millimetres; where these do not fit, in the finest unit that holds the largest depth. */
export async function depthPng({ width, height, depth }: Layers): Promise<Blob> {
  const [near, far] = range(depth);
  const holds = (perMetre: number) => Math.round(far * perMetre) <= MOST;
  const perMetre = holds(1000) && near >= 0.0005 ? 1000 : UNITS.find(holds);
  if (perMetre === undefined) throw refused(`a depth of ${far} m does not fit into a 16-bit PNG`, "take the cloud");
  const values = Uint16Array.from(depth, (value) => (value > 0 ? Math.max(1, Math.round(value * perMetre)) : 0));
  return png.write({ width, height, values, perMetre });
}

/** Which pixels a cloud keeps: the largest standard deviation, in metres and relative to the depth, and whether it keeps flying
 *  pixels. */
export interface Cut {
  readonly absolute: number;
  readonly relative: number;
  readonly keepFlying: boolean;
}

/** Encodes a coloured point cloud in the camera frame. */
export function cloudPly(
  { width, height, depth, deviation }: Layers,
  colours: Uint8ClampedArray,
  { fx, fy, cx, cy }: Intrinsics,
  { absolute, relative, keepFlying }: Cut,
): Blob {
  const flying = keepFlying ? null : flyingPixels(depth, width, height, { fx, fy, cx, cy });
  const isSure = (i: number) => !deviation || !(deviation[i]! > absolute || deviation[i]! > relative * depth[i]!);
  const kept = Array.from(depth.keys()).filter((i) => !flying?.[i] && isSure(i));
  const size = deviation ? 19 : 15;
  const body = new DataView(new ArrayBuffer(size * kept.length));
  kept.forEach((i, place) => {
    const z = depth[i]!;
    const position = [(((i % width) - cx) / fx) * z, ((Math.floor(i / width) - cy) / fy) * z, z];
    position.forEach((value, axis) => body.setFloat32(size * place + 4 * axis, value, true));
    for (let c = 0; c < 3; c++) body.setUint8(size * place + 12 + c, colours[4 * i + c]!);
    if (deviation) body.setFloat32(size * place + 15, deviation[i]!, true);
  });
  const properties = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue", ...(deviation ? ["float sigma"] : [])];
  const lines = ["ply", "format binary_little_endian 1.0", `element vertex ${kept.length}`, ...properties.map((one) => `property ${one}`), "end_header", ""];
  return new Blob([lines.join("\n"), body.buffer], { type: "application/x-ply" });
}
