/**
 * The interface of `lsdc` on a separate worker, so that calls do not block the page: every function returns a promise.
 *
 *     const completer = await Completer.load();
 *     const scene = await completer.scene(imageData);
 *     const { depth } = await scene.complete([[12, 40.5, 2.31], …]);
 */

import { LsdcError } from "./error.ts";
import { pixels, type ImageSource } from "./images.ts";
import { rows, type Points } from "./points.ts";
import type { Call, Reply } from "./protocol.ts";
import type { CompleteOptions, Completion, LoadOptions, SceneOptions } from "./types.ts";

export { LsdcError, type ErrorKind } from "./error.ts";
export type { ImageSource, Pixels } from "./images.ts";
export type { Points, Row } from "./points.ts";
export type * from "./types.ts";

const SAME_SITE = "the files of the package must be on the site of the page";

interface Waiting {
  resolve(result: number | Completion): void;
  reject(error: LsdcError): void;
}

/** Calls of a worker, and their replies. */
class Calls {
  private readonly worker: Worker;
  private readonly waiting = new Map<number, Waiting>();
  private ended: LsdcError | null = null;
  private last = 0;

  constructor() {
    try {
      this.worker = new Worker(new URL("./thread.js", import.meta.url), { type: "module" });
    } catch (cause) {
      throw new LsdcError("load", `the worker cannot be started: ${cause instanceof Error ? cause.message : String(cause)}`, SAME_SITE, { cause });
    }
    this.worker.addEventListener("message", ({ data }: MessageEvent<Reply>) => {
      const waiting = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if ("result" in data) return waiting?.resolve(data.result);
      const { kind, message, hint } = data.error;
      waiting?.reject(new LsdcError(kind, message, hint));
    });
    this.worker.addEventListener("error", ({ message }) => {
      this.end(new LsdcError("load", `the worker cannot run: ${message || "its script cannot be fetched"}`, SAME_SITE));
    });
  }

  ask(call: Call, transfer: Transferable[] = []): Promise<number | Completion> {
    if (this.ended) return Promise.reject(this.ended);
    const id = ++this.last;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.worker.postMessage({ ...call, id }, transfer);
    });
  }

  end(why: LsdcError): void {
    this.ended ??= why;
    this.worker.terminate();
    for (const { reject } of this.waiting.values()) reject(this.ended);
    this.waiting.clear();
  }
}

/** A network and its settings, on a separate worker. */
export class Completer {
  private readonly calls: Calls;

  private constructor(calls: Calls) {
    this.calls = calls;
  }

  /** Starts the worker, and fetches the module and weights. Rejects if any cannot be fetched or used. */
  static async load({ weights = "default" }: LoadOptions = {}): Promise<Completer> {
    const calls = new Calls();
    try {
      await calls.ask({ call: "load", weights: weights instanceof URL ? weights.href : weights });
    } catch (error) {
      calls.end(error as LsdcError);
      throw error;
    }
    return new Completer(calls);
  }

  /** Runs the network on a copy of an image. Rejects if the image cannot be used. */
  async scene(image: ImageSource, options: SceneOptions = {}): Promise<Scene> {
    const { width, height, data } = pixels(image);
    const copy = data.slice();
    const number = await this.calls.ask({ call: "scene", image: { width, height, data: copy }, options }, [copy.buffer]);
    return new Scene(this.calls, number as number, width, height);
  }

  /** Ends the worker, which frees the completer and its scenes; waiting calls are rejected. */
  free(): void {
    this.calls.end(new LsdcError("use", "the completer was freed before", "load another one"));
  }
}

/** An image, ready to be fitted to points. */
export class Scene {
  readonly width: number;
  readonly height: number;
  private readonly calls: Calls;
  private readonly number: number;

  /** @internal */
  constructor(calls: Calls, number: number, width: number, height: number) {
    this.calls = calls;
    this.number = number;
    this.width = width;
    this.height = height;
  }

  /** Fits the scene to points. Rejects if no point can be used; unusable points are counted in the report. */
  async complete(points: Points, { columns, ...options }: CompleteOptions = {}): Promise<Completion> {
    const table = rows(points, columns);
    const result = await this.calls.ask({ call: "complete", scene: this.number, rows: table, options }, [table.buffer]);
    return result as Completion;
  }

  /** Frees the scene, which cannot be used afterwards. */
  free(): void {
    void this.calls.ask({ call: "free", scene: this.number }).catch(() => undefined);
  }
}
