// Reads files of points in the browser.

import * as npy from "../model/npy.ts";
import { count } from "../model/numbers.ts";
import type { Point } from "../model/points.ts";
import { ServiceError } from "../service.ts";
import * as png from "./png.ts";

export const READS = "Images: JPEG, PNG, WebP, BMP. Points: depth maps (npy, 16-bit png), tables (csv, txt).";

/** Value of 16-bit maps at pixels without a measurement, besides 0. */
const LARGEST = 65_535;

interface Size {
  readonly width: number;
  readonly height: number;
}

export interface Read {
  readonly points: readonly Point[];
  /** Assumptions that the user should check. */
  readonly remarks: readonly string[];
}

/** An error of the user's files or settings, with the status of such errors of the service. */
export const refused = (message: string, hint: string | null): ServiceError => new ServiceError(message, hint, 422);

/** Reads the points of a file for an image of a size. */
export async function read(file: File, size: Size): Promise<Read> {
  const ending = file.name.toLowerCase().split(".").pop();
  switch (ending) {
    case "csv":
    case "txt":
      return { points: table(file.name, await file.text()), remarks: [] };
    case "npy": {
      const map = npy.read(await file.arrayBuffer());
      if (!map) throw refused(`\`${file.name}\` is no map of 32- or 64-bit floats, row by row`, "save it with `numpy.save`, as float32 of two dimensions");
      const listed = (map.width === 3 || map.width === 4) && map.width !== size.width;
      return { points: listed ? rows(map) : pixels(file.name, map, size, 1), remarks: [] };
    }
    case "png": {
      const map = await png.read(await file.arrayBuffer());
      if (!map) throw refused(`\`${file.name}\` is no PNG of 16-bit grey without interlacing`, "depths need 16 bits; as npy they can be floats");
      const perMetre = map.perMetre ?? 1000;
      const marks = map.values.reduce((marks, value) => marks + Number(value === LARGEST), 0);
      const remarks = [
        ...(map.perMetre === null ? [`\`${file.name}\` has no unit; its depths are taken for millimetres`] : []),
        ...(marks > 0 ? [`${count(marks)} pixels are ${LARGEST}, the largest number of 16 bits, and are left out`] : []),
      ];
      return { points: pixels(file.name, { ...map, values: map.values.map((value) => (value === LARGEST ? 0 : value)) }, size, perMetre), remarks };
    }
    default:
      throw refused(`this page does not read points from \`${file.name}\``, "give npy, csv or a 16-bit png; `lsdc view` reads all formats");
  }
}

/** The pixels of a map that are not 0; the fit counts and skips other values that are not depths. */
function pixels(name: string, { width, height, values }: npy.Map2 | png.Grey16, size: Size, perMetre: number): Point[] {
  if (width !== size.width || height !== size.height) {
    throw refused(`\`${name}\` has ${width}x${height} pixels, but the image ${size.width}x${size.height}`, "give points at their positions, as a table of u, v, depth");
  }
  return Array.from(values).flatMap((value, i) => (value === 0 ? [] : [{ u: i % width, v: Math.floor(i / width), depth: value / perMetre }]));
}

const rows = ({ width, height, values }: npy.Map2): Point[] =>
  Array.from({ length: height }, (_, i) => point(Array.from(values.subarray(i * width, (i + 1) * width))));

const point = ([u, v, depth, sigma]: readonly (number | undefined)[]): Point =>
  ({ u: u ?? NaN, v: v ?? NaN, depth: depth ?? NaN, ...(sigma !== undefined && !Number.isNaN(sigma) && { sigma }) });

/** Reads lines of u, v, depth and optionally sigma, in this order or in that of a header line. */
function table(name: string, text: string): Point[] {
  const lines = text.split(/\r?\n/).map((line, i) => ({ cells: line.trim().split(/\s*[,;]\s*|\s+/), number: i + 1 }));
  const filled = lines.filter(({ cells }) => cells[0] !== "" && !cells[0]!.startsWith("#"));
  const hint = "lines are u,v,depth or u,v,depth,sigma; a first line of these names gives another order";
  const names = filled[0] && Number.isNaN(Number(filled[0].cells[0])) ? filled.shift()!.cells : ["u", "v", "depth", "sigma"];
  const places = ["u", "v", "depth", "sigma"].map((column) => names.indexOf(column));
  if (places.slice(0, 3).includes(-1)) throw refused(`\`${name}\` has columns ${names.join(", ")}, but not all of u, v and depth`, hint);
  return filled.map(({ cells, number }) => {
    const values = places.map((place) => (cells[place] ? Number(cells[place]) : undefined));
    const wrong = cells.length > names.length || places.slice(0, 3).some((place) => !cells[place]);
    if (wrong || cells.some((cell) => Number.isNaN(Number(cell)) && cell.toLowerCase() !== "nan")) {
      throw refused(`\`${name}\`: line ${number} is no point`, hint);
    }
    return point(values);
  });
}

/** Remarks on points that the fit skipped. */
export function leftOut({ ignored, outside }: { readonly ignored: number; readonly outside: number }): string[] {
  return [
    ...(ignored > 0 ? [`${count(ignored)} points have no depth or position that can be used`] : []),
    ...(outside > 0 ? [`${count(outside)} points are outside the image`] : []),
  ];
}
