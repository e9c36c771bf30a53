// What every function of the package throws.

/**
 * - `image`, `weights`, `settings`, `fit`: the argument that cannot be used; `fit` is that of points;
 * - `use`: an object that was freed, or an argument of another type;
 * - `memory`: memory for an argument cannot be had;
 * - `load`: the module or weights cannot be fetched, or WebAssembly lacks SIMD;
 * - `stopped`: the module has stopped. Its completer and scenes cannot be used again.
 */
export type ErrorKind = "image" | "weights" | "settings" | "fit" | "use" | "memory" | "load" | "stopped";

/** What is wrong, in one sentence, and what to do about it. */
export class LsdcError extends Error {
  override readonly name = "LsdcError";
  readonly kind: ErrorKind;
  readonly hint: string | null;

  constructor(kind: ErrorKind, message: string, hint: string | null = null, options?: ErrorOptions) {
    super(message, options);
    this.kind = kind;
    this.hint = hint;
  }
}
