// An instance of the WebAssembly module, whose functions exchange only numbers, bytes and JSON.

import { LsdcError, type ErrorKind } from "./error.ts";
import { fetched } from "./fetched.ts";

/** The exports, documented in `crates/wasm/src/lib.rs`. */
interface Exports {
  readonly memory: WebAssembly.Memory;
  lsdc_start(): number;
  lsdc_input(bytes: number): number;
  lsdc_load(): number;
  lsdc_scene(width: number, height: number, channels: number, best: number): number;
  lsdc_complete(scene: number, count: number): number;
  lsdc_free(scene: number): void;
  lsdc_text(): number;
  lsdc_text_length(): number;
  lsdc_output(which: number): number;
  lsdc_output_length(which: number): number;
}

/** Outputs of a completion. */
export const OUTPUT = { depth: 0, deviations: 1, residuals: 2, leaveOneOut: 3 } as const;

let compiled: Promise<WebAssembly.Module> | null = null;

/** The module, compiled once. */
function compile(): Promise<WebAssembly.Module> {
  compiled ??= fetched(new URL("./lsdc.wasm", import.meta.url), "the WebAssembly module")
    .then((bytes) => WebAssembly.compile(bytes as BufferSource))
    .catch((cause: unknown) => {
      compiled = null;
      if (!(cause instanceof WebAssembly.CompileError)) throw cause;
      const hint = "WebAssembly needs SIMD: Chrome 91, Firefox 89, Safari 16.4, Node.js 16.4 or later";
      throw new LsdcError("load", `the WebAssembly module cannot be compiled: ${cause.message}`, hint, { cause });
    });
  return compiled;
}

export class Instance {
  /** The error that stopped the instance. */
  private stopped: LsdcError | null = null;
  private exports: Exports | null;
  /** Address of the message of a panic. */
  private readonly message: number;

  private constructor(exports: Exports) {
    this.exports = exports;
    this.message = exports.lsdc_start();
  }

  static async create(): Promise<Instance> {
    const { exports } = await WebAssembly.instantiate(await compile(), {});
    return new Instance(exports as unknown as Exports);
  }

  /** Memory of the instance in bytes, which only `free` releases. */
  get memory(): number {
    return this.exports?.memory.buffer.byteLength ?? 0;
  }

  /** Releases the instance to the garbage collector. */
  free(): void {
    this.exports = null;
  }

  load(weights: Uint8Array): void {
    this.run((exports) => {
      this.write(exports, [weights]);
      return exports.lsdc_load();
    });
  }

  /** Creates a scene, and returns its number. */
  scene(width: number, height: number, channels: number, data: Uint8Array | Uint8ClampedArray, best: boolean): number {
    return this.run((exports) => {
      this.write(exports, [data]);
      return exports.lsdc_scene(width, height, channels, Number(best));
    });
  }

  /** Completes points in rows of four numbers, and returns the report in JSON. */
  complete(scene: number, rows: Float64Array, options: object): string {
    return this.run((exports) => {
      const bytes = new Uint8Array(rows.buffer, rows.byteOffset, rows.byteLength);
      this.write(exports, [bytes, new TextEncoder().encode(json(options))]);
      return exports.lsdc_complete(scene, rows.length / 4) && this.text(exports);
    });
  }

  /** Copies an output of the last completion; null if there is none. */
  output(which: number): Float32Array | null {
    return this.guarded((exports) => {
      const length = exports.lsdc_output_length(which);
      return length > 0 ? new Float32Array(exports.memory.buffer, exports.lsdc_output(which) >>> 0, length).slice() : null;
    });
  }

  freeScene(scene: number): void {
    if (this.exports && !this.stopped) this.guarded((exports) => exports.lsdc_free(scene));
  }

  /** Calls a function that returns 0 if it fails. */
  private run<T>(work: (exports: Exports) => T | 0 | ""): T {
    return this.guarded((exports) => {
      const result = work(exports);
      if (result) return result;
      const { kind, message, hint } = JSON.parse(this.text(exports)) as { kind: ErrorKind; message: string; hint: string | null };
      throw new LsdcError(kind, message, hint);
    });
  }

  /** Uses the module. A trap stops the instance, because its state may be inconsistent. */
  private guarded<T>(work: (exports: Exports) => T): T {
    if (this.stopped) throw this.stopped;
    if (!this.exports) throw new LsdcError("use", "the completer was freed before", "load another one");
    try {
      return work(this.exports);
    } catch (cause) {
      if (cause instanceof LsdcError) throw cause;
      throw (this.stopped = this.trap(this.exports, cause));
    }
  }

  private trap(exports: Exports, cause: unknown): LsdcError {
    const bytes = new Uint8Array(exports.memory.buffer, this.message, 512);
    const panic = new TextDecoder().decode(bytes.subarray(0, bytes.indexOf(0))).replaceAll("\n", " ");
    const why = panic || (cause instanceof Error ? cause.message : String(cause));
    const hint = panic
      ? "load another completer; this is an error in lsdc, please report it"
      : "load another completer; its memory may have run out: free scenes that are not needed, or use smaller images";
    return new LsdcError("stopped", `the WebAssembly module has stopped: ${why}`, hint, { cause });
  }

  /** Writes the input of the next call. */
  private write(exports: Exports, parts: readonly (Uint8Array | Uint8ClampedArray)[]): void {
    const length = parts.reduce((sum, part) => sum + part.length, 0);
    let address = exports.lsdc_input(length) >>> 0;
    if (address === 0) throw new LsdcError("memory", `${length} bytes of memory cannot be had`, "free scenes, or use smaller images");
    const memory = new Uint8Array(exports.memory.buffer);
    for (const part of parts) {
      memory.set(part, address);
      address += part.length;
    }
  }

  private text(exports: Exports): string {
    const bytes = new Uint8Array(exports.memory.buffer, exports.lsdc_text() >>> 0, exports.lsdc_text_length());
    return new TextDecoder().decode(bytes);
  }
}

/** Encodes options in JSON; rejects NaN, which would become null, the default of an option. */
function json(options: object): string {
  return JSON.stringify(options, (name, value: unknown) => {
    if (typeof value === "number" && !Number.isFinite(value)) throw new LsdcError("settings", `the option \`${name}\` is ${value}`);
    return value;
  });
}
