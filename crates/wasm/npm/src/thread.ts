// The script of a worker: a completer, and scenes by numbers.

import { Completer, LsdcError, type Scene } from "./index.ts";
import type { Reply, Request } from "./protocol.ts";
import type { Completion, Weights } from "./types.ts";

interface WorkerScope {
  addEventListener(type: "message", listener: (event: MessageEvent<Request>) => void): void;
  postMessage(message: Reply, transfer: Transferable[]): void;
}

const scope = globalThis as unknown as WorkerScope;
const scenes = new Map<number, Scene>();
let completer: Completer | null = null;
let last = 0;

async function answer(request: Request): Promise<number | Completion> {
  switch (request.call) {
    case "load": {
      const { weights } = request;
      const named = weights === "default" || weights === "small" || typeof weights !== "string";
      completer = await Completer.load({ weights: named ? (weights as Weights) : new URL(weights) });
      return 0;
    }
    case "scene":
      scenes.set(++last, completer!.scene(request.image, request.options));
      return last;
    case "complete": {
      const scene = scenes.get(request.scene);
      if (!scene) throw new LsdcError("use", "the scene was freed before");
      return scene.complete(request.rows, { ...request.options, columns: 4 });
    }
    case "free":
      scenes.get(request.scene)?.free();
      scenes.delete(request.scene);
      return 0;
  }
}

scope.addEventListener("message", ({ data }) => {
  void answer(data).then(
    (result) => {
      const maps = typeof result === "number" ? [] : [result.depth, result.deviations, result.residuals, result.leaveOneOut];
      scope.postMessage({ id: data.id, result }, maps.flatMap((map) => map?.buffer ?? []) as ArrayBuffer[]);
    },
    (error: unknown) => {
      const { kind, message, hint } = error instanceof LsdcError ? error : new LsdcError("stopped", String(error));
      scope.postMessage({ id: data.id, error: { kind, message, hint } }, []);
    },
  );
});
