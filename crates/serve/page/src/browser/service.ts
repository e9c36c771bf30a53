// Completes images in a worker of the browser, for a page without a program behind it.

import { Completer, LsdcError, type Completion, type Scene } from "../../../../wasm/npm/src/worker.ts";
import type { Layers } from "../model/layers.ts";
import { row, type Point } from "../model/points.ts";
import { MEASURED } from "../model/settings.ts";
import { ServiceError, type Asked, type Demo, type Options, type PostedScene, type Service } from "../service.ts";
import { leftOut, read, READS, refused, type Read } from "./read.ts";
import { cloudPly, depthPng } from "./write.ts";

interface Known {
  readonly scene: Scene;
  readonly pixels: ImageData;
}

const ALL: readonly Asked[] = ["depth", "standard_deviation", "outliers"];
/** Status at which the page posts an image again. */
const GONE = 404;
const UNREACHABLE = 0;

class BrowserService implements Service {
  readonly reads = READS;
  readonly cameras = false;
  readonly formats = ["png", "ply", "json"] as const;
  private completer: Promise<Completer> | null = null;
  private readonly known = new Map<string, Known>();
  private last = 0;

  async start(): Promise<object> {
    // Loads the worker early; an error is reported when it is used.
    this.loaded().catch(() => undefined);
    return {};
  }

  demos = async (): Promise<Demo[]> => JSON.parse(await (await this.file("demo/demos.json")).text());

  gallery = async () => ({ runs: [] });

  async file(address: string): Promise<Blob> {
    const reply = await fetch(address).catch(() => null);
    if (reply?.ok) return reply.blob();
    throw new ServiceError(`${address} cannot be fetched`, "check the connection, then try again", UNREACHABLE);
  }

  async post(image: File, camera: File | null): Promise<PostedScene> {
    if (camera) throw refused("this page reads no camera files", "set the field of view, or use `lsdc view`");
    const pixels = await decoded(image);
    const scene = await this.guarded(async () => (await this.loaded()).scene(pixels));
    const id = String(++this.last);
    this.known.set(id, { scene, pixels });
    return { id, width: pixels.width, height: pixels.height };
  }

  forget(id: string): void {
    this.known.get(id)?.scene.free();
    this.known.delete(id);
  }

  async fit(id: string, given: readonly Point[] | File, fit: Options, asked: readonly Asked[]): Promise<Layers> {
    const { scene } = this.get(id);
    const { points, remarks }: Read = given instanceof File ? await read(given, scene) : { points: given, remarks: [] };
    return layers(await this.complete(scene, points, fit, asked), points, remarks);
  }

  async download(id: string, points: readonly Point[], options: Options, format: string): Promise<Blob> {
    const { scene } = this.get(id);
    const found = await this.complete(scene, points, options, format === "json" ? ALL : ["depth"]);
    if (format === "json") return new Blob([JSON.stringify(found.report, null, 2)], { type: "application/json" });
    return depthPng(layers(found, points, []));
  }

  async cloud({ id }: { readonly id: string }, points: readonly Point[], options: Options, camera: Parameters<typeof cloudPly>[2]): Promise<Blob> {
    const { scene, pixels } = this.get(id);
    const found = await this.complete(scene, points, options, ["depth", "standard_deviation"]);
    const { max_sigma: absolute = null, max_relative_sigma: relative = MEASURED, keep_flying: keepFlying = false } = options;
    return cloudPly(layers(found, points, []), pixels.data, camera, { absolute: absolute ?? Infinity, relative, keepFlying });
  }

  private complete(scene: Scene, points: readonly Point[], { robust, fit, prior, sigma }: Options, asked: readonly Asked[]): Promise<Completion> {
    const outputs = { deviations: asked.includes("standard_deviation"), outliers: asked.includes("outliers") };
    return this.guarded(() => scene.complete(points.map(row), { robust, fit, prior, sigma, ...outputs }));
  }

  private loaded(): Promise<Completer> {
    return (this.completer ??= Completer.load().catch((error: unknown) => {
      this.completer = null;
      throw error;
    }));
  }

  private get(id: string): Known {
    const known = this.known.get(id);
    if (!known) throw new ServiceError("the image is no longer known", "open it again", GONE);
    return known;
  }

  /** Calls the worker, turning its errors into those of a service. A worker that has stopped is replaced at the next call. */
  private async guarded<T>(work: () => Promise<T>): Promise<T> {
    try {
      return await work();
    } catch (error) {
      if (!(error instanceof LsdcError)) throw error;
      const { kind, message, hint } = error;
      if (kind === "stopped") {
        this.known.clear();
        void this.completer?.then((completer) => completer.free());
        this.completer = null;
      }
      throw new ServiceError(message, hint, kind === "stopped" ? GONE : kind === "load" ? UNREACHABLE : 422);
    }
  }
}

export const browser: Service = new BrowserService();

/** Decodes an image to upright pixels, without conversion of colours. */
async function decoded(image: File): Promise<ImageData> {
  const bitmap = await createImageBitmap(image, { colorSpaceConversion: "none", premultiplyAlpha: "none" }).catch(() => null);
  if (!bitmap) throw refused(`\`${image.name}\` is no image that this browser reads`, "give JPEG, PNG or WebP; `lsdc view` reads more");
  const { width, height } = bitmap;
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true })!;
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  return context.getImageData(0, 0, width, height);
}

/** Converts a completion to the form of the service's answers. */
function layers(found: Completion, points: readonly Point[], remarks: readonly string[]): Layers {
  const { width, height, depth, deviations, residuals, leaveOneOut, outliers, report } = found;
  const probabilities = new Map(outliers?.map(({ index, probability }) => [index, probability]));
  const fitted = points.flatMap(({ u, v, depth, sigma }, index) => {
    const residual = residuals[index]!;
    if (Number.isNaN(residual)) return [];
    const error = leaveOneOut?.[index] ?? NaN;
    return [{
      index, u, v, depth, residual,
      sigma: sigma ?? null,
      leaveOneOut: Number.isNaN(error) ? null : error,
      deviation: deviations?.[Math.round(v) * width + Math.round(u)] ?? null,
      outlier: outliers && (probabilities.get(index) ?? 0),
    }];
  });
  const { lowest, highest } = report.depth ?? {};
  return {
    width, height, depth, deviation: deviations, points: fitted,
    report: {
      depth: { ...(lowest !== undefined && { lowest }), ...(highest !== undefined && { highest }) },
      fit: report.fit,
      points: { ...report.points },
      seconds: { fit: report.seconds.completion, network: report.seconds.network },
      remarks: [...remarks, ...leftOut(report.points), ...report.remarks],
    },
  };
}
