// Tells image, points and camera apart among opened files.

export interface Sorted {
  readonly image: File | null;
  readonly points: File | null;
  readonly camera: File | null;
  readonly unknown: readonly File[];
}

const PICTURES = ["jpg", "jpeg", "webp", "bmp", "ppm", "pnm"];
const EITHER = ["png", "tif", "tiff"];
const POINTS = ["npy", "npz", "exr", "pfm", "h5", "csv", "txt", "xyz", "ply", "pcd", "las", "laz", "bin", "pgm"];
const CAMERAS = ["toml", "yaml", "yml"];

export const ACCEPT_IMAGE = [...PICTURES, ...EITHER].map((name) => `.${name}`).join(",");
export const ACCEPT_POINTS = [...POINTS, "png", "tif", "tiff", "json"].map((name) => `.${name}`).join(",");
export const ACCEPT_CAMERA = [...CAMERAS, "json"].map((name) => `.${name}`).join(",");

export async function sorted(files: readonly File[]): Promise<Sorted> {
  const found: { image: File | null; points: File | null; camera: File | null; unknown: File[] } = {
    image: null, points: null, camera: null, unknown: [],
  };
  for (const file of files) {
    const kind = await kindOf(file, found.image !== null);
    if (kind && !found[kind]) found[kind] = file;
    else found.unknown.push(file);
  }
  return found;
}

async function kindOf(file: File, haveImage: boolean): Promise<"image" | "points" | "camera" | null> {
  const extension = file.name.toLowerCase().split(".").pop() ?? "";
  if (PICTURES.includes(extension)) return "image";
  if (POINTS.includes(extension)) return "points";
  if (CAMERAS.includes(extension)) return "camera";
  if (extension === "json") return (await file.slice(0, 64).text()).trimStart().startsWith("[") ? "points" : "camera";
  if (extension === "png") return (await isDepthPng(file)) ? "points" : haveImage ? "points" : "image";
  if (EITHER.includes(extension)) return haveImage ? "points" : "image";
  return file.type.startsWith("image/") ? "image" : null;
}

/** Whether a PNG has 16 bits of grey and is taken for a depth map. */
async function isDepthPng(file: File): Promise<boolean> {
  const header = new Uint8Array(await file.slice(0, 26).arrayBuffer());
  return header[24] === 16 && header[25] === 0;
}
