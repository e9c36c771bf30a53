// Messages between a page and its worker.

import type { ErrorKind } from "./error.ts";
import type { Pixels } from "./images.ts";
import type { CompleteOptions, Completion, LoadOptions, SceneOptions } from "./types.ts";

export type Call =
  | { readonly call: "load"; readonly weights: NonNullable<LoadOptions["weights"]> | string }
  | { readonly call: "scene"; readonly image: Pixels; readonly options: SceneOptions }
  | { readonly call: "complete"; readonly scene: number; readonly rows: Float64Array; readonly options: CompleteOptions }
  | { readonly call: "free"; readonly scene: number };

export type Request = Call & { readonly id: number };

export type Reply =
  | { readonly id: number; readonly result: number | Completion }
  | { readonly id: number; readonly error: { readonly kind: ErrorKind; readonly message: string; readonly hint: string | null } };
