/**
 * Depth completion by least squares: an RGB image and a few known depths in, a dense depth map out.
 *
 * Calls run on the calling thread and block it: pages should use `lsdc/worker`, which has the same interface.
 *
 *     const completer = await Completer.load();
 *     const scene = completer.scene(imageData);                // runs the network
 *     const { depth } = scene.complete([[12, 40.5, 2.31], …]);  // runs a fit; again for other points
 */

import { LsdcError } from "./error.ts";
import { fetched } from "./fetched.ts";
import { pixels, type ImageSource } from "./images.ts";
import { Instance, OUTPUT } from "./module.ts";
import { rows, type Points } from "./points.ts";
import type { CompleteOptions, Completion, LoadOptions, Outlier, Report, SceneOptions, Weights } from "./types.ts";

export { LsdcError, type ErrorKind } from "./error.ts";
export type { ImageSource, Pixels } from "./images.ts";
export type { Points, Row } from "./points.ts";
export type * from "./types.ts";

/** Literal URLs, so that bundlers find the files. */
const WEIGHTS = {
  default: new URL("./weights/default.safetensors", import.meta.url),
  small: new URL("./weights/small.safetensors", import.meta.url),
};

/** A network and its settings, in separate memory. */
export class Completer {
  private readonly instance: Instance;

  private constructor(instance: Instance) {
    this.instance = instance;
  }

  /** Fetches the module and weights. Throws if either cannot be fetched or used. */
  static async load({ weights = "default" }: LoadOptions = {}): Promise<Completer> {
    const [instance, bytes] = await Promise.all([Instance.create(), contents(weights)]);
    instance.load(bytes);
    return new Completer(instance);
  }

  /** Runs the network on an image. Throws if the image cannot be used. */
  scene(image: ImageSource, { quality = "standard" }: SceneOptions = {}): Scene {
    if (quality !== "standard" && quality !== "best") {
      throw new LsdcError("settings", `there is no quality "${String(quality)}"`, 'it is "standard" or "best"');
    }
    const { width, height, channels, data } = pixels(image);
    const started = performance.now();
    const number = this.instance.scene(width, height, channels, data, quality === "best");
    return new Scene(this.instance, number, width, height, (performance.now() - started) / 1000);
  }

  /** Memory of the completer and its scenes in bytes: the largest amount needed so far. */
  get memory(): number {
    return this.instance.memory;
  }

  /** Frees the completer and its scenes, which cannot be used afterwards. */
  free(): void {
    this.instance.free();
  }
}

/** An image, ready to be fitted to points. */
export class Scene {
  readonly width: number;
  readonly height: number;
  private readonly instance: Instance;
  private readonly number: number;
  private readonly network: number;

  /** @internal */
  constructor(instance: Instance, number: number, width: number, height: number, network: number) {
    this.instance = instance;
    this.number = number;
    this.width = width;
    this.height = height;
    this.network = network;
  }

  /** Fits the scene to points. Throws if no point can be used; unusable points are counted in the report. */
  complete(points: Points, { columns, ...options }: CompleteOptions = {}): Completion {
    const started = performance.now();
    const text = this.instance.complete(this.number, rows(points, columns), options);
    const { outliers, ...report } = JSON.parse(text) as Omit<Report, "seconds"> & { outliers: Outlier[] | null };
    const output = (which: number): Float32Array | null => this.instance.output(which);
    const maps = {
      depth: output(OUTPUT.depth)!,
      deviations: output(OUTPUT.deviations),
      residuals: output(OUTPUT.residuals)!,
      leaveOneOut: output(OUTPUT.leaveOneOut),
    };
    const seconds = { network: this.network, completion: (performance.now() - started) / 1000 };
    return { width: this.width, height: this.height, ...maps, outliers, report: { ...report, seconds } };
  }

  /** Frees the scene, which cannot be used afterwards. */
  free(): void {
    this.instance.freeScene(this.number);
  }
}

async function contents(weights: Weights): Promise<Uint8Array> {
  if (weights instanceof Uint8Array) return weights;
  if (weights instanceof ArrayBuffer) return new Uint8Array(weights);
  if (weights instanceof URL) return fetched(weights, "the weights");
  const address = Object.hasOwn(WEIGHTS, weights) ? WEIGHTS[weights] : null;
  if (!address) throw new LsdcError("settings", `there are no weights "${String(weights)}"`, 'give "default", "small", a URL or the contents of a file');
  return fetched(address, "the weights");
}
