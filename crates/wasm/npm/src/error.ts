// The errors of the package.

/**
 * - `image`, `weights`, `settings`, `fit`: an unusable argument; `fit` refers to the points;
 * - `use`: an object that was freed, or an argument of another type;
 * - `memory`: memory for an argument cannot be allocated;
 * - `load`: the module or weights cannot be fetched, or WebAssembly lacks SIMD;
 * - `stopped`: the module has stopped. Its completer and scenes cannot be used any more.
 */
export type ErrorKind = "image" | "weights" | "settings" | "fit" | "use" | "memory" | "load" | "stopped";

/** An error: a message of one sentence, and a hint. */
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
